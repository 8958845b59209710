"""Colours of a torus: each tile once, and where it lies."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from data_gen.tiles import COLOURS
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, read_bundle, write_bundle
from mesoshell.io.corner_tiles import SIDE, is_torus, places, seed_origin


def test_each_tile_lies_where_its_corners_have_its_colours():
    for tile, (i, j) in enumerate(places(COLOURS)):
        corners = [COLOURS[(j + b) % SIDE][(i + a) % SIDE] for b in (0, 1) for a in (0, 1)]
        assert corners == [tile >> k & 1 for k in range(4)]
    assert len(np.unique(places(COLOURS), axis=0)) == 16


def test_what_is_a_torus():
    assert is_torus(COLOURS) and is_torus([list(row) for row in COLOURS])
    flipped = [list(row) for row in COLOURS]
    flipped[0][0] ^= 1
    for bad in (flipped, COLOURS[:3], [row[:3] for row in COLOURS], [[0.0] * 4] * 4, [[2] * 4] * 4, "0123", None, 4):
        assert not is_torus(bad)


def test_seeds_show_parts_of_the_plane_that_are_far_apart():
    origins = np.array([seed_origin(s) for s in (0, 1, 2, 2**16 - 1, 2**16, 2**32 - 1)], np.int64)
    assert seed_origin(0) == (0, 0) and origins.max() < 2**32
    apart = np.abs(origins[:, None] - origins[None]).max(axis=2)
    assert apart[~np.eye(len(origins), dtype=bool)].min() >= 2**15


@pytest.mark.parametrize("turned", [np.rot90, np.transpose, np.flipud])
def test_turned_a_torus_stays_one(turned):
    assert is_torus(turned(np.array(COLOURS)).tolist())


def test_a_bundle_of_tiles_is_read_as_it_was_written(tmp_path: Path, tiled_bundle: Bundle, tiny_bundle: Bundle):
    write_bundle(tmp_path / "a.npz", tiled_bundle)
    write_bundle(tmp_path / "b.npz", tiny_bundle)
    found = read_bundle(tmp_path / "a.npz")
    assert found.tiles == tuple(map(tuple, COLOURS)) and found.texel_density == 4
    assert found.arrays["features/0"].shape == (16, 16, 4)
    np.testing.assert_array_equal(found.arrays["features/0"], tiled_bundle.arrays["features/0"])
    with np.load(tmp_path / "a.npz") as a, np.load(tmp_path / "b.npz") as b:
        tiled, one = (json.loads(x["manifest.json"].tobytes()) for x in (a, b))
    assert tiled["schema"] == 3 and one["schema"] == 2 and "tiles" not in one, "files without tiles are as they were"


def test_what_is_coarser_than_a_patch_is_the_mean_of_all_tiles(tiled_bundle: Bundle):
    mean = tiled_bundle.arrays["features/0"].astype(np.float64).mean(axis=(0, 1))
    assert [tiled_bundle.arrays[f"features/{i}"].shape[0] for i in range(5)] == [16, 8, 4, 2, 1]
    for level in (3, 4):
        found = tiled_bundle.arrays[f"features/{level}"]
        np.testing.assert_allclose(found, np.broadcast_to(mean, found.shape), atol=2e-3)
    assert np.ptp(tiled_bundle.arrays["features/2"], axis=(0, 1)).min() > 0.1


def test_bundles_whose_texture_is_no_torus_are_refused(tmp_path: Path, tiled_bundle: Bundle, tiny_bundle: Bundle):
    for bundle, fault in (
        (
            dataclasses.replace(tiny_bundle, tiles=COLOURS),
            "features/0 of corner tiles is 4 × 4 texels; expected 16 × 16",
        ),
        (dataclasses.replace(tiled_bundle, tiles=((0,) * 4,) * 4), "expected null or the colours of a torus of 4 x 4"),
        (dataclasses.replace(tiled_bundle, wraps=False), "corner tiles need a texture that wraps"),
        (
            dataclasses.replace(tiled_bundle, generator={}),
            "corner tiles need a texture that wraps, without a generator",
        ),
    ):
        with pytest.raises(InputError, match=fault):
            write_bundle(tmp_path / "bad.npz", bundle)
    assert not (tmp_path / "bad.npz").exists()


@pytest.mark.parametrize(("name", "schema"), [("a.npz", 2), ("b.npz", 3)])
def test_a_schema_says_whether_there_are_tiles(name, schema, tmp_path: Path, tiled_bundle: Bundle, tiny_bundle: Bundle):
    write_bundle(tmp_path / name, tiled_bundle if name == "a.npz" else tiny_bundle)
    with np.load(tmp_path / name) as file:
        arrays = dict(file)
    manifest = json.loads(arrays["manifest.json"].tobytes()) | {"schema": schema}
    arrays["manifest.json"] = np.frombuffer(json.dumps(manifest).encode(), np.uint8)
    np.savez(tmp_path / name, **arrays)
    with pytest.raises(InputError, match="schema 3 is of corner tiles" if name == "a.npz" else "'tiles' is missing"):
        read_bundle(tmp_path / name)
