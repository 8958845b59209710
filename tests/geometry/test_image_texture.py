"""Images of albedo: what is looked up is what the image shows there, and from afar its mean."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from mesoshell.geometry import image_texture
from mesoshell.geometry.albedo import Albedo
from mesoshell.geometry.colour import LINEAR
from mesoshell.geometry.image_texture import Texture, texture_of
from mesoshell.geometry.mesh import Mesh, check_mesh

RANDOM = np.random.default_rng(0)


def image(h: int, w: int) -> Texture:
    return texture_of(Image.fromarray(RANDOM.integers(0, 256, (h, w, 3), np.uint8)), (0.5, 1.0, 2.0))


def middles(h: int, w: int) -> np.ndarray:
    y, x = np.mgrid[:h, :w]
    return np.stack([(x + 0.5) / w, 1 - (y + 0.5) / h], axis=-1).reshape(-1, 2)


@pytest.mark.parametrize(("h", "w"), [(4, 8), (5, 3), (1, 1), (1, 7)])
def test_a_texel_is_seen_in_its_middle_and_repeats(h: int, w: int):
    """v = 1 lies at the first row."""
    texture, uv = image(h, w), middles(h, w)
    expected = np.minimum(LINEAR[texture.codes] * [0.5, 1, 2], 1).reshape(-1, 3)
    for shift in ((0, 0), (3, -2), (-1, 5)):
        np.testing.assert_allclose(texture.at(uv + shift, np.zeros(len(uv))), expected, atol=1e-6)


@given(st.integers(0, 7), st.integers(0, 2**32 - 1))
def test_each_level_has_the_mean_of_the_image(level: int, seed: int):
    """And lies between its least and greatest values."""
    texture = image(64, 128)
    uv = np.random.default_rng(seed).uniform(-2, 2, (50, 2))
    found = texture.at(uv, np.full(50, 2.0**level / 128))
    assert (found >= texture.image.min() - 1e-6).all() and (found <= texture.image.max() + 1e-6).all()
    whole = texture.at(middles(64, 128), np.full(64 * 128, 2.0**level / 128)).mean(axis=0)
    np.testing.assert_allclose(whole, texture.image.mean(axis=(0, 1)), atol=1e-3)


@pytest.mark.parametrize("width", [np.nan, np.inf, 1e30, 2.0])
def test_from_afar_it_is_its_mean(width: float):
    texture = image(32, 32)
    found = texture.at(RANDOM.uniform(size=(9, 2)), np.full(9, width))
    np.testing.assert_allclose(found, np.tile(texture.image.mean(axis=(0, 1)), (9, 1)), atol=1e-5)


def test_images_of_all_kinds_are_taken(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(image_texture, "MOST", 16)
    grey = RANDOM.integers(0, 2**16, (64, 8), np.uint16)
    sixteen = texture_of(Image.fromarray(grey))
    assert sixteen.codes.shape == (16, 2, 3) and abs(int(sixteen.codes.mean()) - 128) < 20
    for mode in ("1", "L", "LA", "P", "RGBA", "CMYK"):
        assert texture_of(Image.new("RGB", (3, 2), (255, 255, 255)).convert(mode)).codes.shape == (2, 3, 3)


def square(at: float) -> Mesh:
    corners = np.array([[0.0, 0.0, at], [2.0, 0.0, at], [2.0, 2.0, at], [0.0, 2.0, at]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return check_mesh(corners, faces, corners[faces][:, :, :2] / 2, "square")


def test_each_face_has_its_own_albedo():
    """By the base, a colour, or an image; and a pixel of the square's size sees its mean."""
    texture = image(2, 2)
    objects = [
        square(1),
        replace(square(2), colour=(0.1, 0.2, 0.3)),
        replace(square(3), colour=(1.0, 0.0, 0.0), texture=texture),
    ]
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
