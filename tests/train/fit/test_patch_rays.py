"""Pictures of patches as rays: against the cameras' own rays, the closed form of a box, and the images."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.dataset import read_dataset
from mesoshell.io.dataset_images import load_images
from mesoshell.render.camera import Camera, pixel_grid, rays
from mesoshell.train.fit import patch_rays
from mesoshell.train.fit.holdout import held_pictures
from mesoshell.train.fit.patch_rays import gather_fit_data, rays_at
from tests.helpers import fog
from tests.helpers.patch_images import of_patches, of_tiles

NO_KEY = np.zeros(2, np.uint32)


def test_pixels_that_meet_the_box_are_learned(tmp_path: Path):
    dataset = fog.write(tmp_path / "set", fog.CAMERAS)
    data = gather_fit_data([dataset])
    assert len(data.learned) == 1 and len(data.held[0]) == 0
    images = load_images(dataset).reshape(-1, 4)
    found = 0
    for k, sample in enumerate(dataset.samples):
        camera = Camera(np.asarray(sample.camera_to_world), sample.fov, *sample.size)
        o, d = rays(camera, pixel_grid(camera, 1, 0))
        near, far = fog.through_box(o, d)
        own = data.learned[0][(data.learned[0] >= data.first[k]) & (data.learned[0] < data.first[k + 1])]
        np.testing.assert_array_equal(own - data.first[k], np.flatnonzero(far > near))
        row = rays_at(data, own, 0, NO_KEY)
        np.testing.assert_allclose(row.origin, o[far > near], rtol=1e-6)
        np.testing.assert_allclose(row.direction, d[far > near], atol=1e-6)
        y = images[own]
        np.testing.assert_allclose(row.target[:, :3], y[:, :3] / (1 + y[:, :3]), rtol=2e-3)  # kept in half precision
        np.testing.assert_allclose(row.target[:, 3], y[:, 3], rtol=1e-3)
        np.testing.assert_allclose(row.alpha[:, 0], 0.05 + k / 10, rtol=1e-6)
        found += len(own)
    assert found == len(data.learned[0])


def test_the_angle_of_view_is_across_the_width(tmp_path: Path):
    data = gather_fit_data([fog.write(tmp_path / "set", fog.CAMERAS[:1])])
    wide = replace(data, samples=(replace(data.samples[0], size=(18, 8)),))
    corner = rays_at(wide, np.array([17]), 0, NO_KEY).direction[0] @ wide.samples[0].camera_to_world[:3, :3]
    np.testing.assert_allclose(corner[:2] / -corner[2], np.tan(fog.FOV / 2) * np.array([17, 7]) / 18, rtol=1e-5)
    found = patch_rays._pixel_rays(wide.samples[0])[1][17]
    np.testing.assert_allclose(found @ wide.samples[0].camera_to_world[:3, :3], corner, rtol=1e-5)


def test_radiance_beyond_half_precision_stays_finite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(patch_rays, "load_image", lambda sample: np.full((*sample.size, 4), 7e4, np.float32))
    data = gather_fit_data([fog.write(tmp_path / "set", fog.CAMERAS[:1])])
    assert np.isfinite(data.target(np.arange(9))).all()


def test_a_test_set_has_its_own_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """By whatever path its folder is given."""
    monkeypatch.chdir(tmp_path)
    fog.write(Path("set"), fog.CAMERAS)
    fog.write(Path("set/test"), fog.CAMERAS[:2])
    monkeypatch.chdir("set")
    data = gather_fit_data([read_dataset(Path())], held=1, tests=[read_dataset(Path("test"))])
    assert held_pictures(data, Path()) == [(0, 3)]
    assert held_pictures(data, Path("test")) == [(0, 4), (0, 5)]


def test_datasets_of_the_same_patches_add_up(tmp_path: Path):
    a, b = of_patches(tmp_path / "a", [0, 0, 1, 1]), of_patches(tmp_path / "b", [1, 1, 0, 0])
    data = gather_fit_data([a, b], held=1)
    assert len(data.learned) == 2
    for k, pictures in enumerate(([0, 6], [2, 4])):  # the last of each patch, in each dataset, is held out
        np.testing.assert_array_equal(np.unique(np.searchsorted(data.first, data.learned[k], "right") - 1), pictures)
    alone = gather_fit_data([a], tests=[b])
    assert sum(map(len, alone.held)) == sum(map(len, gather_fit_data([b]).learned))


def test_a_geometry_a_picture_is_refused(tmp_path: Path):
    dataset = fog.write(tmp_path / "set", fog.CAMERAS[:2])
    wild = replace(dataset, manifest=dataset.manifest | {"patch": None})
    with pytest.raises(
        InputError, match="set: every image shows another geometry; render it with --patch 0, --patches 16 or --tiles"
    ):
        gather_fit_data([wild])


def test_a_geometry_that_varies_is_refused(tmp_path: Path):
    dataset = fog.write(tmp_path / "set", fog.CAMERAS[:2])
    length = {"length": {"role": "beta", "range": [0, 1]}}
    samples = tuple(replace(s, parameters=s.parameters | {"length": k / 4}) for k, s in enumerate(dataset.samples))
    manifest = dataset.manifest | {"parameters": dataset.manifest["parameters"] | length, "patch": 0}
    with pytest.raises(InputError, match="set: its geometry varies with length; fix it with --param length=VALUE"):
        gather_fit_data([replace(dataset, manifest=manifest, samples=samples)])


def test_what_is_learned_from_is_no_test(tmp_path: Path):
    dataset = fog.write(tmp_path / "set", fog.CAMERAS[:2])
    with pytest.raises(InputError, match="set: is learned from"):
        gather_fit_data([dataset], tests=[dataset])


def test_other_parameters_are_refused(tmp_path: Path):
    a, b = (fog.write(tmp_path / name, fog.CAMERAS[:2]) for name in "ab")
    text = json.dumps(b.manifest["parameters"]).replace("nothing", "something")
    other = replace(b, manifest=b.manifest | {"parameters": json.loads(text)})
    with pytest.raises(InputError, match="b: has another recipe or other parameters than the first dataset"):
        gather_fit_data([a, other])


def test_nothing_to_learn_from_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match="has a patch whose pictures are all held out: none is left to learn from"):
        gather_fit_data([of_patches(tmp_path / "a", [0, 0, 1, 1])], held=2)


def test_tiles_are_patches_in_the_order_of_the_torus(tmp_path: Path):
    data = gather_fit_data([of_tiles(tmp_path / "a", [*range(15, -1, -1)])])
    assert data.tiles == 4
    shown = [np.unique(np.searchsorted(data.first, p, side="right") - 1).tolist() for p in data.learned]
    assert shown == [[15 - k] for k in range(16)]


def test_tiles_that_are_no_torus_are_refused(tmp_path: Path):
    missing, all_ = of_tiles(tmp_path / "a", [*range(15)]), of_tiles(tmp_path / "b", [*range(16)])
    with pytest.raises(InputError, match="shows 15 of the 16 tiles: give it a --count of 16 or more"):
        gather_fit_data([missing])
    with pytest.raises(InputError, match="has other tiles than the first dataset"):
        gather_fit_data([all_, of_patches(tmp_path / "c", [0])])
    with pytest.raises(InputError, match="its tiles are not the colours of a torus"):
        gather_fit_data([of_tiles(tmp_path / "d", [*range(16)], [[0] * 4] * 4)])
