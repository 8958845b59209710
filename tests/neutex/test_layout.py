"""Images of a sphere: what a pixel stands for is found there again."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mesoshell.neutex.layout import LAYOUTS, checkerboard, directions, lookup, place, shape, side_of

found_in = jax.jit(lookup, static_argnums=0)
UNIT = st.tuples(*[st.floats(-1, 1, width=32)] * 3).filter(lambda u: np.linalg.norm(u) > 0.1)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_pixels_direction_lies_in_its_middle(layout) -> None:
    u = directions(layout, 8)
    h, w = shape(layout, 8)
    assert u.shape == (h, w, 3)
    np.testing.assert_allclose(np.linalg.norm(u, axis=-1), 1, atol=1e-6)
    found = jax.vmap(lambda u: place(layout, u, 8))(u.reshape(-1, 3))
    y, x = np.meshgrid((np.arange(h) + 0.5) / h, (np.arange(w) + 0.5) / w, indexing="ij")
    np.testing.assert_allclose(found, np.stack([x, y], axis=-1).reshape(-1, 2), atol=1e-5)


@cache
def _image(layout) -> jax.Array:
    return jnp.asarray(directions(layout, 64))


@pytest.mark.parametrize("layout", LAYOUTS)
@given(u=UNIT)
@example(u=(3e-42, 3e-42, 1.0))
@example(u=(-3e-42, 1e-38, -1.0))
def test_an_image_of_directions_gives_them_back(layout, u) -> None:
    """Bilinear in a fine image; seams and corners included."""
    wanted = np.array(u) / np.linalg.norm(u)
    found = found_in(layout, _image(layout), jnp.asarray(wanted, jnp.float32))
    assert float(jnp.abs(found - wanted).max()) < 0.06


@pytest.mark.parametrize("layout", LAYOUTS)
def test_poles_and_axes_have_a_place(layout) -> None:
    for u in np.concatenate([np.eye(3), -np.eye(3)]):
        at = np.asarray(place(layout, jnp.asarray(u, jnp.float32), 16))
        assert np.isfinite(at).all() and (at >= 0).all() and (at <= 1).all()


def test_proportions_tell_the_layout() -> None:
    assert side_of("cubemap", 128, 192) == 64 and side_of("latlong", 64, 128) == 64 and side_of("square", 64, 64) == 64
    assert (
        side_of("cubemap", 64, 64) is None and side_of("latlong", 64, 64) is None and side_of("square", 64, 128) is None
    )


def test_cubemap_squares_are_seen_from_outside() -> None:
    """Of a square's pixels, those to the right and upward are where a viewer before it has right and up: text can be read."""
    u = directions("cubemap", 8)
    for row in range(2):
        for column in range(3):
            face = u[8 * row : 8 * row + 8, 8 * column : 8 * column + 8]
            ahead = face.mean(axis=(0, 1))
            right, up = face[:, -1].mean(axis=0) - face[:, 0].mean(axis=0), face[0].mean(axis=0) - face[-1].mean(axis=0)
            assert np.cross(right, up) @ ahead > 0


def test_latlong_goes_around() -> None:
    image = jnp.asarray(directions("latlong", 32))
    a, b = (lookup("latlong", image, jnp.array([-1.0, e, 0.0])) for e in (1e-4, -1e-4))
    np.testing.assert_allclose(a, b, atol=1e-3)


def test_the_checkerboard_has_as_many_dark_squares_as_light() -> None:
    board = checkerboard("cubemap", 64, 8)
    assert abs(float((board.max(axis=-1) > 0.5).mean()) - 0.5) < 0.01
