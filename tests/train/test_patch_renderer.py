"""Pictures of the unit box agree with the shell's boundary, and with fog's closed form."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.render.camera import Camera, look_at, pixel_grid, rays
from mesoshell.shell.geometry.extrude import Shell
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.shell.material.decoder import init_decoder
from mesoshell.shell.material.field import inputs
from mesoshell.train.patch_renderer import (
    PictureConfig,
    View,
    box_span,
    discriminator_range,
    material_of,
    pixel_rays,
    rays_a_tile,
    take_picture,
)
from tests.helpers.fog import CAMERAS, FOV, through_box
from tests.helpers.scenes import unit_box

CONFIG = PictureConfig(size=16, samples=64, fov=FOV, texels=8, height_rows=8, octaves=2)


def pose(eye: tuple[float, float, float]) -> np.ndarray:
    return look_at(eye, (0.5, 0.5, 0.5), (0.0, 0.0, 1.0))


@pytest.mark.parametrize("eye", CAMERAS)
def test_rays_are_the_renderers(eye) -> None:
    camera = Camera(pose(eye), FOV, 16, 16)
    _, expected = rays(camera, pixel_grid(camera, 1, 0))
    origin, found = pixel_rays(CONFIG, jnp.asarray(pose(eye), jnp.float32))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    np.testing.assert_allclose(origin, eye, rtol=1e-6)


def box_intervals(boundary: Boundary, shell: Shell, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """t at both ends of each ray's first two intervals (a unit box has no third), (R, 2, 2)."""
    i = boundary.trace(o, d).intervals
    rank = np.arange(len(i.ray)) - np.searchsorted(i.ray, i.ray)
    few = rank < 2
    t = np.zeros((len(o), 2, 2), np.float32)
    t[i.ray[few], rank[few]] = np.stack([i.t0, i.t1], axis=1)[few]
    return t


@pytest.mark.parametrize("eye", [*CAMERAS, (0.5, 0.5, 3.0)])
def test_spans_are_the_shells(eye) -> None:
    """The same distances as the walk through the shell's prisms, a camera straight above included."""
    camera = Camera(pose(eye), 0.9, 24, 24)
    o, d = rays(camera, pixel_grid(camera, 1, 0))
    shell = unit_box()
    t = box_intervals(Boundary(shell, shell.faces, opaque=False), shell, o, d)
    expected = (t[..., 1] - t[..., 0]).sum(axis=1)
    t0, t1 = jax.vmap(box_span, in_axes=(None, 0))(jnp.asarray(eye, jnp.float32), jnp.asarray(d, jnp.float32))
    np.testing.assert_allclose(t1 - t0, expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("d", [(0.0, 0.0, 0.0), (np.nan, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_degenerate_rays_have_finite_spans_and_gradients(d) -> None:
    o = jnp.array([0.5, 0.5, 2.0])
    value, gradient = jax.value_and_grad(lambda o: box_span(o, jnp.asarray(d, jnp.float32))[1])(o)
    assert jnp.isfinite(value) and jnp.isfinite(gradient).all()


def fog_picture(samples_scale: float, eye: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """A material whose σ and ρ are constant: its features and weights are 0, so that only biases speak."""
    decoder = init_decoder(jax.random.key(0), 4 + 1 + 2 * 2 + 1, (8,), (8,))
    decoder = jax.tree.map(jnp.zeros_like, decoder)._replace(scale=jnp.asarray(samples_scale))
    material = material_of(CONFIG, jnp.zeros((8, 8, 4)), jnp.zeros((8, 4)), decoder)
    view = View(
        jnp.asarray(pose(eye), jnp.float32), jnp.array([0.6, 0.0, 0.8]), jnp.array([10.0, 8.0, 6.0]), jnp.zeros(1)
    )
    found = take_picture(CONFIG, decoder, partial(inputs, material, CONFIG.layout), view, jnp.full((1, 64), 0.5))
    camera = Camera(pose(eye), FOV, 16, 16)
    near, far = through_box(*rays(camera, pixel_grid(camera, 1, 0)))
    alpha = -np.expm1(-samples_scale * np.log1p(np.exp(-3.0)) * (far - near)).reshape(16, 16)
    rho = np.log1p(np.exp(-2.0))
    return np.asarray(found), np.concatenate(
        [rho * np.array([10.0, 8.0, 6.0]) * alpha[..., None], alpha[..., None]], axis=2
    )


@pytest.mark.parametrize("eye", CAMERAS)
@pytest.mark.parametrize("scale", [0.0, 30.0, 1e7])
def test_fog_is_what_it_is_in_closed_form(eye, scale: float) -> None:
    found, expected = fog_picture(scale, eye)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_what_is_shown_lies_in_its_range() -> None:
    np.testing.assert_allclose(
        discriminator_range(jnp.array([[[[0.0, 1.0, 1e30]]]])), [[[[-1.0, 0.0, 1.0]]]], atol=1e-6
    )


def test_without_filtering_there_is_one_level() -> None:
    config = PictureConfig(16, 64, FOV, 8, 8, 2, filtering=False)
    assert config.layout.sizes == ((8, 8),) and len(config.layout.height_sizes) == 1
    assert len(replace(config, filtering=True).layout.sizes) == 4


def test_filtering_chooses_coarser_features_far_away() -> None:
    """A chequered texture: from far away its mean is seen, unless filtering is off."""
    decoder = init_decoder(jax.random.key(0), 4 + 1 + 2 * 2, (8,), (8,))
    chequer = jnp.asarray(np.indices((8, 8)).sum(axis=0) % 2 * 2.0 - 1.0, jnp.float32)
    feature = jnp.broadcast_to(chequer[..., None], (8, 8, 4))
    view = View(jnp.asarray(pose((4.0, 4.0, 16.0)), jnp.float32), jnp.array([0.0, 0.0, 1.0]), jnp.ones(3), jnp.zeros(0))
    jitter = jnp.full((1, 64), 0.5)

    def picture(config: PictureConfig, feature) -> np.ndarray:
        see = partial(inputs, material_of(config, feature, jnp.zeros((8, 4)), decoder), config.layout)
        return np.asarray(take_picture(config, decoder, see, view, jitter))

    filtered, mean = picture(CONFIG, feature), picture(CONFIG, jnp.zeros((8, 8, 4)))
    sharp = picture(PictureConfig(16, 64, FOV, 8, 8, 2, filtering=False), feature)
    assert np.abs(filtered - mean).max() < 0.2 * np.abs(sharp - mean).max()


@pytest.mark.parametrize("samples", [1, 7, 24, 32, 48, 100, 5000])
@pytest.mark.parametrize("side", [8, 20, 32, 128])
def test_tiles_are_large_for_any_number_of_samples(side: int, samples: int) -> None:
    """24 samples of 32² rays once came two rays at a time, and took four times as long."""
    rays = side * side
    size = rays_a_tile(rays, samples)
    assert rays % size == 0 and (size * samples <= 4096 or size == 1)
    assert 2.5 * size * samples > min(4096, rays * samples)
