"""Environment maps: sampling against direct sums over pixels, and density against lookup."""

import numpy as np
import pytest

from mesoshell.render.light import environment, lookup, sample

DRAWS = 40_000


def pixels(h: int, w: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions on a fine grid in a z-up map (h, w), 8 × 8 points a pixel, and the solid angle each stands for."""
    theta, phi = (np.arange(h * 8) + 0.5) / (h * 8) * np.pi, (np.arange(w * 8) + 0.5) / (w * 8) * 2 * np.pi
    edges = np.cos(np.arange(h * 8 + 1) / (h * 8) * np.pi)
    s, c = np.sin(theta)[:, None], np.broadcast_to(np.cos(theta)[:, None], (h * 8, w * 8))
    d = np.stack([s * np.cos(phi), s * np.sin(phi), c], axis=-1).reshape(-1, 3)
    return d, np.repeat(-np.diff(edges) * 2 * np.pi / (w * 8), w * 8)


def sky(seed: int = 1, h: int = 6, w: int = 12) -> np.ndarray:
    radiance = np.random.default_rng(seed).uniform(0, 1, (h, w, 3))
    radiance[1, 3] = [400.0, 300.0, 200.0]  # a sun
    radiance[4] = 0
    return radiance


@pytest.mark.parametrize("up", [1, 2])
def test_irradiance_from_drawn_directions(up: int):
    e, normal = environment(sky(), up), np.array([0.48, 0.64, 0.6])
    d, weight = sample(e, np.random.default_rng(2).random((DRAWS, 3)))
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, rtol=1e-12)
    each = weight * np.maximum(d @ normal, 0)[:, None]
    grid, solid = pixels(6, 12)
    if up == 1:
        grid = np.stack([grid[:, 0], grid[:, 2], -grid[:, 1]], axis=1)  # the map's pole to +y
    true = (lookup(e, grid) * np.maximum(grid @ normal, 0)[:, None] * solid[:, None]).sum(axis=0)
    assert (np.abs(each.mean(axis=0) - true) < 4 * each.std(axis=0) / np.sqrt(DRAWS)).all()


def test_weight_is_radiance_over_the_density_of_the_pixel():
    e = environment(sky(), 2)
    d, weight = sample(e, np.random.default_rng(3).random((DRAWS, 3)))
    column, row = (0.5 - np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi)) % 1 * 12, np.arccos(d[:, 2]) / np.pi * 6
    cell = row.astype(int) * 12 + column.astype(int)
    edges = np.cos(np.arange(7) / 6 * np.pi)
    density = (np.diff(e.cumulative, prepend=0) / np.repeat(-np.diff(edges) * 2 * np.pi / 12, 12))[cell]
    np.testing.assert_allclose(weight, lookup(e, d) / density[:, None], rtol=1e-6, atol=1e-9)
    drawn = np.bincount(cell, minlength=72) / DRAWS
    mass = np.diff(e.cumulative, prepend=0)
    assert (np.abs(drawn - mass) <= 4 * np.sqrt(mass * (1 - mass) / DRAWS) + 1 / DRAWS).all()


def test_poles_and_the_seam_belong_to_a_pixel():
    e = environment(sky(), 2)
    d = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [1, -1e-17, 0], [-1, 0, 0], [0, 0, 1.0000001]], float)
    assert np.isfinite(lookup(e, d)).all()
    np.testing.assert_array_equal(lookup(e, d[:2]), e.radiance[[0, 5], [6, 6]])


def test_y_up_turns_the_map_with_its_pole():
    z, y = (environment(sky(), up) for up in (2, 1))
    np.testing.assert_array_equal(lookup(y, np.array([[0.0, 1.0, 0.0]])), lookup(z, np.array([[0.0, 0.0, 1.0]])))


def test_the_last_numbers_below_one_draw_a_direction():
    e = environment(sky(), 2)
    d, weight = sample(e, np.array([[1 - 2**-53] * 3, [0.0] * 3]))
    assert np.isfinite(d).all() and np.isfinite(weight).all()


def test_a_black_map_gives_no_light():
    _, weight = sample(environment(np.zeros((2, 4, 3)), 2), np.random.default_rng(4).random((10, 3)))
    np.testing.assert_array_equal(weight, 0)
