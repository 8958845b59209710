"""Images of albedo: what is looked up is what the image shows there, and from afar its mean."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from mesoshell.geometry import image_texture
from mesoshell.geometry.albedo import Albedo
from mesoshell.geometry.colour import LINEAR, colour_of
from mesoshell.geometry.image_texture import Texture, codes_of
from mesoshell.geometry.mesh import Mesh, check_mesh

FACTOR = (0.5, 1.0, 0.25)


def image(h: int, w: int, seed: int = 0) -> Texture:
    codes = np.random.default_rng(seed).integers(0, 256, (h, w, 3), np.uint8)
    return Texture(codes_of(Image.fromarray(codes)), FACTOR)


def middles(h: int, w: int) -> np.ndarray:
    y, x = np.mgrid[:h, :w]
    return np.stack([(x + 0.5) / w, 1 - (y + 0.5) / h], axis=-1).reshape(-1, 2)


@pytest.mark.parametrize(("h", "w"), [(4, 8), (5, 3), (1, 1), (1, 7)])
def test_a_texel_is_seen_in_its_middle_and_repeats(h: int, w: int):
    """v = 1 lies at the first row."""
    texture, uv = image(h, w), middles(h, w)
    expected = LINEAR[texture.codes].reshape(-1, 3) * FACTOR
    for shift in ((0, 0), (3, -2), (-1, 5)):
        np.testing.assert_allclose(texture.at(uv + shift, np.zeros(len(uv))), expected, atol=1e-6)
    np.testing.assert_allclose(texture.image.reshape(-1, 3), expected, atol=1e-6)


@given(st.integers(1, 70), st.integers(1, 70), st.integers(0, 6), st.integers(0, 2**32 - 1))
def test_each_level_has_the_mean_of_the_image(h: int, w: int, level: int, seed: int):
    """Of any size; and lies between its least and greatest values."""
    texture, width = image(h, w, seed), 2.0**level / np.sqrt(h * w)
    uv = np.random.default_rng(seed).uniform(-2, 2, (50, 2))
    found = texture.at(uv, np.full(50, width))
    assert (found >= texture.image.min() - 1e-6).all() and (found <= texture.image.max() + 1e-6).all()
    k = min(level, len(texture._smaller))
    rows, columns = (h, w) if k == 0 else texture._smaller[k - 1].shape[:2]
    whole = texture.at(middles(rows, columns), np.full(rows * columns, width)).mean(axis=0)
    np.testing.assert_allclose(whole, texture.image.mean(axis=(0, 1)), atol=1e-5)


@pytest.mark.parametrize("width", [np.nan, np.inf, 1e30, 1e3])
@pytest.mark.parametrize(("h", "w"), [(32, 32), (5, 5), (64, 8), (33, 1)])
def test_from_afar_it_is_its_mean(width: float, h: int, w: int):
    texture = image(h, w)
    found = texture.at(np.random.default_rng(0).uniform(size=(9, 2)), np.full(9, width))
    np.testing.assert_allclose(found, np.tile(texture.image.mean(axis=(0, 1)), (9, 1)), atol=1e-5)


def test_a_large_image_is_made_smaller_as_light(monkeypatch: pytest.MonkeyPatch):
    """Black and white by turns is as bright as half of white, and not as the middle code."""
    monkeypatch.setattr(image_texture, "MOST", 16)
    monkeypatch.setattr(image_texture, "TOGETHER", 7)
    checks = (255 * (np.indices((64, 32)).sum(axis=0) % 2)).astype(np.uint8)
    codes = codes_of(Image.fromarray(checks))
    assert codes.shape == (16, 8, 3)
    np.testing.assert_allclose(LINEAR[codes], 0.5, atol=5e-3)
    odd = image(61, 37)
    np.testing.assert_allclose(LINEAR[odd.codes].mean(), 0.333, atol=0.03)  # of codes that are alike often
    assert odd.codes.shape == (16, 10, 3)


RED = (200, 10, 30)


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "P", "CMYK", "LA", "L", "1", "I;16"])
def test_images_of_all_kinds_are_taken(mode: str):
    plain = Image.new("RGB", (3, 2), RED)
    if mode == "I;16":
        made = Image.fromarray(np.full((2, 3), 40_000, np.uint16))
    else:
        made = plain.quantize(4) if mode == "P" else plain.convert(mode)
    codes = codes_of(made)
    expected = {"L": 69, "LA": 69, "1": None, "I;16": 40_000 >> 8}.get(mode, RED)
    assert codes.shape == (2, 3, 3)
    if expected is not None:
        np.testing.assert_allclose(codes.astype(int), np.broadcast_to(expected, codes.shape), atol=2)
    assert colour_of((1, 1, 1), made) == pytest.approx(tuple(LINEAR[codes].mean(axis=(0, 1))))


def test_what_is_not_opaque_shows_the_mean_of_what_is():
    rgba = np.zeros((4, 4, 4), np.uint8)
    rgba[:2, :2] = (*RED, 255)
    leaf = Image.fromarray(rgba)
    codes = codes_of(leaf)
    assert (codes == RED).all()
    assert colour_of((1, 1, 1), leaf) == pytest.approx(tuple(LINEAR[list(RED)]))
    assert (codes_of(Image.fromarray(0 * rgba)) == 0).all()  # nothing is opaque


def test_levels_are_not_pickled():
    texture = image(64, 64)
    before = pickle.dumps(texture)
    texture.at(np.zeros((1, 2)), np.ones(1))
    assert pickle.dumps(texture) == before
    np.testing.assert_array_equal(pickle.loads(before).image, texture.image)


def square(at: float) -> Mesh:
    corners = np.array([[0.0, 0.0, at], [2.0, 0.0, at], [2.0, 2.0, at], [0.0, 2.0, at]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return check_mesh(corners, faces, corners[faces][:, :, :2] / 2, "square")


def test_each_face_has_its_own_albedo():
    """By the base, a colour, or an image; and a pixel of the square's size sees its mean."""
    texture = image(2, 2)
    worn = replace(square(3), colour=(1.0, 0.0, 0.0), texture=texture)
    objects = [square(1), replace(square(2), colour=(0.1, 0.2, 0.3)), worn]
    albedo = Albedo(3, objects, (0.7, 0.8, 0.9))
    face = np.arange(9)
    bary = np.full((9, 2), 1 / 3)
    found = albedo.at(face, bary, np.zeros(9), np.ones(9))
    np.testing.assert_allclose(found[:5], np.tile([0.7, 0.8, 0.9], (5, 1)))
    np.testing.assert_allclose(found[5:7], np.tile([0.1, 0.2, 0.3], (2, 1)))
    where = objects[2].uv.mean(axis=1).astype(np.float64)
    np.testing.assert_allclose(found[7:], texture.at(where, np.zeros(2)), atol=1e-6)
    for pixel, cosine in ((2.0, 1.0), (1.0, 0.25), (1.0, 0.0)):
        afar = albedo.at(face, bary, np.full(9, pixel), np.full(9, cosine))[7:]
        np.testing.assert_allclose(afar, np.tile(texture.image.mean(axis=(0, 1)), (2, 1)), atol=1e-6)


def test_faces_on_a_texel_have_its_colour():
    """As on palettes, whose texture coordinates have no area: they are not unwrapped."""
    texture = image(2, 2)
    mesh = square(0)
    uv = np.repeat(middles(2, 2)[:2], 3, axis=0).reshape(2, 3, 2)
    worn = replace(check_mesh(mesh.vertices, mesh.faces, uv, "palette", bare=True), texture=texture)
    np.testing.assert_allclose(worn.uv, uv, atol=1e-6)
    found = Albedo(0, [worn], (0.0, 0.0, 0.0)).at(np.arange(2), np.full((2, 2), 0.2), np.ones(2), np.ones(2))
    np.testing.assert_allclose(found, texture.image[0], atol=1e-6)
