"""Drawn numbers are even over the rays of a pixel and over its neighbours, and a picture of theirs does not know its tiles."""

import os
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.render.camera import Camera, centred, look_at, outward, rays
from mesoshell.render.light import beams, environment, sample
from mesoshell.render.sequence import PLANE, SPACE, draws_at
from mesoshell.render.tiles import render_pass, render_tiles

SIDE = 32
PIXELS = np.stack(np.divmod(np.arange(SIDE * SIDE), SIDE)[::-1], axis=1)


def gaps(x: np.ndarray) -> np.ndarray:
    """Distances between consecutive of n numbers of a circle, times n."""
    x = np.sort(x % 1)
    return np.diff(x, append=x[0] + 1) * len(x)


def test_strides_are_roots_of_their_dimensions():
    for d, strides in ((2, PLANE), (3, SPACE)):
        x = 1 / strides[0]
        assert abs(x ** (d + 1) - x - 1) < 1e-12
        np.testing.assert_allclose(strides, x ** -np.arange(1.0, d + 1), rtol=1e-12)


@given(st.integers(0, 5000), st.integers(0, 5000), st.integers(0, 1000), st.integers(1, 300))
def test_numbers_lie_in_the_unit_cube(column, row, k, count):
    own = draws_at(np.array([[column, row]]), outward(k))
    for x in (own.numbers(), own.triples(count)):
        assert ((x >= 0) & (x < 1)).all()
    assert own.triples(count).shape == (count, 1, 3)


@pytest.mark.parametrize("n", [2, 5, 16, 100])
def test_rays_of_a_pixel_draw_numbers_far_apart(n):
    """Of numbers drawn at random the largest gap is log n times the mean."""
    one = np.stack([draws_at(PIXELS, centred(n, k)).numbers() for k in range(n)])
    assert all(gaps(x).max() < 2.8 for x in one.T[::97])


def test_neighbours_draw_numbers_far_apart():
    r = draws_at(PIXELS, 0.5).rotation.reshape(SIDE, SIDE, 4)
    for a, b in ((r[1:], r[:-1]), (r[:, 1:], r[:, :-1])):
        between = np.abs((a - b + 0.5) % 1 - 0.5)
        assert between.min() > 0.2


def test_a_picture_draws_every_number_as_often():
    """The share of numbers below each of them; of random ones 0.04 would be usual."""
    x = draws_at(PIXELS, 1.0)
    for some in (x.numbers(), *x.triples(1)[0].T):
        assert np.abs(np.sort(some) - (np.arange(len(some)) + 0.5) / len(some)).max() < 0.01


def test_irradiance_of_a_sky_is_drawn_with_half_the_error_of_random_numbers():
    """Of a plane that looks up, from eight directions a ray and nine rays."""
    sky = environment(np.random.default_rng(0).gamma(0.3, size=(16, 32, 1)) * np.ones(3), up=2)

    def mean(points: np.ndarray) -> np.ndarray:
        """(directions, pixels, 3) -> (pixels,)"""
        toward, strength = sample(sky, points.reshape(-1, 3))
        return (np.maximum(toward[:, 2], 0) * strength[:, 0]).reshape(points.shape[:2]).mean(axis=0)

    ours = mean(np.concatenate([draws_at(PIXELS, outward(k)).triples(8) for k in range(9)]))
    random = mean(np.random.default_rng(1).random((72, len(PIXELS), 3)))
    true = mean(np.random.default_rng(2).random((2000, len(PIXELS), 3))).mean()
    assert abs(ours.mean() - true) < 0.01 * true
    assert np.std(ours) < 0.5 * np.std(random)


@pytest.mark.parametrize("size", [(1, 2), (4, 8), (16, 32)])
def test_a_picture_sees_the_whole_sky_in_a_ray_a_pixel(size: tuple[int, int]) -> None:
    """Its mean irradiance by two directions: no error is common to all pixels, on planes that look up, aside and aslant."""
    sky, draws = environment(np.ones((*size, 3)), up=2), draws_at(PIXELS, 0.0)
    for normal in ([0, 0, 1], [1, 0, 0], [0, -1, 0], [0.48, 0.6, -0.64]):
        each = beams((), sky, 2, draws)
        mean = sum((np.maximum(b.toward @ np.array(normal), 0) * b.strength[:, 0]).mean() for b in each)
        assert mean == pytest.approx(np.pi, rel=0.01)


def test_beams_carry_the_light_of_the_sky():
    """E of all directions together is the sky's mean radiance times its solid angle."""
    sky = environment(np.full((8, 16, 3), 0.7), up=1)
    for count in (1, 8):
        each = beams((), sky, count, draws_at(PIXELS, 3.0))
        assert len(each) == count
        np.testing.assert_allclose(np.sum([b.strength for b in each], axis=0), 0.7 * 4 * np.pi, rtol=1e-6)
    assert beams((), None, 8, draws_at(PIXELS, 0.0)) == []


def test_a_pass_that_nobody_waits_for_ends():
    """Within its tiles, and without those that were not begun."""
    stop, begun, worked = threading.Event(), [], []
    camera = Camera(look_at((0, 0, 3), (0, 0, 0)), 0.8, 9, 7)
    (first,) = rays(camera, np.array([[0.5, 0.5]]))[1]

    def tile(o, d, shift, draws, check):
        begun.append(d)
        assert np.allclose(d, first) or stop.wait(30)
        check()
        worked.append(d)
        return np.zeros((len(o), 4))

    def progress(share: float) -> None:
        if share > 0 or stop.is_set():
            stop.set()
            raise InterruptedError

    with pytest.raises(InterruptedError):
        render_pass(camera, 0, np.arange(63), 1, tile, progress)
    assert len(worked) == 1 and len(begun) <= 1 + (os.cpu_count() or 1)


def test_a_picture_does_not_know_its_tiles():
    camera = Camera(look_at((0, 0, 3), (0, 0, 0)), 0.8, 9, 7)

    def tile(o, d, shift, draws, check):
        check()
        return np.concatenate([d * draws.numbers()[:, None], draws.triples(3)[1, :, :1] + shift], axis=1)

    whole, parts = (render_tiles(camera, 3, size, tile, lambda share: None) for size in (63, 5))
    np.testing.assert_array_equal(whole, parts)
    some = np.array([3, 17, 40])
    all_ = render_pass(camera, 2, np.arange(63), 63, tile, lambda share: None)
    np.testing.assert_array_equal(render_pass(camera, 2, some, 2, tile, lambda share: None), all_[some])
