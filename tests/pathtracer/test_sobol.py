"""A path's numbers are as Sobol's of each power of two, and differ by pixel and dimension; pictures of them are the scene's."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.special import comb

from mesoshell.pathtracer.load import load_dict
from mesoshell.pathtracer.passes import as_rgba, can_pass, render_pass
from mesoshell.pathtracer.sobol import Sobol, hash_bits, pascal
from tests.helpers.path_traced import QUALITY, scene, sensor, shell

PIXELS = 8


def drawn(paths: range, skip: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(numbers, points), (pixels, paths) and (pixels, paths, 2), after so many points."""
    pixel, path = (x.ravel() for x in np.meshgrid(np.arange(PIXELS), np.array(paths), indexing="ij"))
    s = Sobol(hash_bits(mi.UInt32(pixel + 1)), mi.UInt32(path), mi.UInt32(0))
    for _ in range(skip):
        s.next_2d()
    line, plane = np.array(s.next_1d()), np.array(s.next_2d()).T
    return line.reshape(PIXELS, -1), plane.reshape(PIXELS, -1, 2)


def test_pascal_is_his_triangle_modulo_two() -> None:
    rows = np.arange(32)
    matrix = np.array([[int(comb(j, r, exact=True)) % 2 for j in rows] for r in rows])
    x = np.random.default_rng(0).integers(0, 2**32, 200, dtype=np.uint64)
    bits = (x[:, None] >> rows.astype(np.uint64)) & 1
    wanted = ((bits @ matrix.T.astype(np.uint64)) % 2) @ (1 << rows.astype(np.uint64))
    np.testing.assert_array_equal(np.array(pascal(mi.UInt32(x.astype(np.uint32)))), wanted)


@pytest.mark.parametrize("first", [0, 1, 5])
@pytest.mark.parametrize("m", [1, 2, 4, 6])
@pytest.mark.parametrize("skip", [0, 3])
def test_each_power_of_two_has_a_point_in_every_interval(first: int, m: int, skip: int) -> None:
    """Every box of 2^-a by 2^(a − m)."""
    n = 2**m
    line, plane = drawn(range(first * n, (first + 1) * n), skip)
    assert (np.sort((line * n).astype(int), axis=1) == np.arange(n)).all()
    for a in range(m + 1):
        box = (plane * [2**a, 2 ** (m - a)]).astype(int) @ [2 ** (m - a), 1]
        assert (np.sort(box, axis=1) == np.arange(n)).all()


def test_other_pixels_and_dimensions_have_other_numbers() -> None:
    line, plane = drawn(range(256))
    _, later = drawn(range(256), 1)
    for a, b in ((line[:-1], line[1:]), (line, plane[..., 0]), (plane[..., 0], plane[..., 1]), (plane, later)):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.08
    assert abs(line.mean() - 0.5) < 0.01 and abs((line**2).mean() - 1 / 3) < 0.01
    assert len(np.unique(line)) > 0.999 * line.size and line.min() >= 0 and line.max() < 1


def test_a_loop_draws_on() -> None:
    """What it draws is what is drawn without one."""

    @dr.syntax
    def third(s, n):
        i, x = mi.UInt32(0), dr.zeros(mi.Float, n)
        while i < 3:
            x = s.next_1d()
            i += 1
        return x

    def sequence() -> Sobol:
        return Sobol(hash_bits(dr.arange(mi.UInt32, 9) + 1), dr.full(mi.UInt32, 6, 9), mi.UInt32(0))

    s = sequence()
    x = [s.next_1d() for _ in range(3)]
    np.testing.assert_array_equal(np.array(third(sequence(), 9)), np.array(x[2]))


def lawn(materials, **film: object):
    """A rough shell under a sky through a lens, its film of 20 × 14 pixels."""
    eye = sensor()
    eye |= {"type": "thinlens", "aperture_radius": 0.15, "focus_distance": 2.0}
    eye["film"] |= {"width": 20, "height": 14, **film}
    light = {"type": "constant", "radiance": 0.5}
    return load_dict(scene(shell(materials, "rough"), light=light, depth=3, eye=eye), QUALITY)


CROPPED = {"crop_width": 9, "crop_height": 6, "crop_offset_x": 7, "crop_offset_y": 3}
FILMS = {
    "box": {},
    "opaque, cropped": {"pixel_format": "rgb", **CROPPED},
    "gaussian, cropped": {"rfilter": {"type": "gaussian"}, **CROPPED},
}


@pytest.mark.parametrize("name", [x if x == "box" else pytest.param(x, marks=pytest.mark.slow) for x in FILMS])
def test_passes_show_what_mitsuba_renders(name: str, materials) -> None:
    """With less noise than as many passes of its own."""
    made = lawn(materials, **FILMS[name])
    width, height = (int(x) for x in made.sensors()[0].film().crop_size())
    all_ = np.arange(width * height)
    true = as_rgba(mi.render(made, spp=484, seed=mi.UInt32(9)))
    ours = np.mean([render_pass(made, all_, k) for k in range(32)], axis=0).reshape(true.shape)
    theirs = np.mean([as_rgba(mi.render(made, spp=1, seed=mi.UInt32(100 + k))) for k in range(32)], axis=0)
    far, near = (np.sqrt(((x - true) ** 2).mean()) for x in (theirs, ours))
    assert true[..., :3].mean() > 0.1 and near < 0.75 * far
    np.testing.assert_allclose(ours.mean(axis=(0, 1)), true.mean(axis=(0, 1)), rtol=0.02)


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 6])
def test_films_of_any_channels_are_colours_and_alpha(channels: int) -> None:
    values = np.arange(6.0 * channels).reshape(2, 3, channels)
    found = as_rgba(mi.TensorXf(values.astype(np.float32)))
    alpha = values[..., -1] if channels in (2, 4) else values[..., 3] if channels > 4 else np.ones((2, 3))
    colours = values[..., :3] if channels > 2 else values[..., [0, 0, 0]]
    np.testing.assert_array_equal(found, np.concatenate([colours, alpha[..., None]], axis=-1))


def test_grey_films_and_those_with_a_border_are_mitsubas(materials) -> None:
    films = [sensor()["film"] | more for more in ({}, {"pixel_format": "luminance"}, {"sample_border": True})]
    assert [can_pass(mi.load_dict(film)) for film in films] == [True, False, False]
