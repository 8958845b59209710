"""Training rays against the closed form of a box's interval, and against the images."""

from pathlib import Path

import fog
import numpy as np

from mesoshell.io.dataset import load_images
from mesoshell.render.camera import Camera, pixel_grid, rays
from mesoshell.train.rays import image_table, join, ray_table


def test_intervals_are_the_boxs(tmp_path: Path):
    dataset = fog.write(tmp_path / "set", fog.CAMERAS)
    table = ray_table(dataset)
    for k, sample in enumerate(dataset.samples):
        camera = Camera(np.asarray(sample.camera_to_world), sample.fov, *sample.size)
        o, d = rays(camera, pixel_grid(camera, 1, 0))
        near, far = fog.through_box(o, d)
        own = table.image == k
        np.testing.assert_array_equal(np.sort(table.pixel[own]), np.flatnonzero(far > near))
        o, d, near, far = (x[table.pixel[own]] for x in (o, d, near, far))
        t, xi = table.t[own], table.xi[own]
        present = t[:, :, 1] > t[:, :, 0]
        np.testing.assert_allclose(t[:, 0, 0], near, atol=2e-6)
        np.testing.assert_allclose(np.where(present, t[:, :, 1], 0).max(axis=1), far, atol=2e-6)
        np.testing.assert_allclose((t[:, :, 1] - t[:, :, 0]).sum(axis=1), far - near, atol=4e-6)
        np.testing.assert_allclose(
            xi[present], (o[:, None, None] + t[..., None] * d[:, None, None])[present], atol=2e-6
        )


def test_targets_are_tonemapped_pixels(tmp_path: Path):
    dataset = fog.write(tmp_path / "set", fog.CAMERAS)
    table, images = ray_table(dataset), load_images(dataset).reshape(len(dataset.samples), -1, 4)
    pixels = images[table.image, table.pixel]
    np.testing.assert_allclose(table.target[:, :3], pixels[:, :3] / (1 + pixels[:, :3]), rtol=1e-6)
    np.testing.assert_allclose(table.target[:, 3], pixels[:, 3], rtol=1e-6)


def test_parameters_are_normalised_and_joined_tables_keep_their_images(tmp_path: Path):
    sets = [fog.write(tmp_path / name, cameras) for name, cameras in (("a", fog.CAMERAS[:1]), ("b", fog.CAMERAS[1:]))]
    parts = [(ray_table(d), image_table(d)) for d in sets]
    table, images = join(parts)
    np.testing.assert_allclose(images.alpha[:, 0], [0.05, 0.05, 0.15, 0.25], rtol=1e-6)
    assert len(table.image) == sum(len(rays.image) for rays, _ in parts)
    np.testing.assert_array_equal(np.unique(table.image), [0, 1, 2, 3])
