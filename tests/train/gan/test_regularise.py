"""The optional helps: a blur that fades to nothing, and the roughness of a density."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter

from mesoshell.shell.material.decoder import init_decoder
from mesoshell.train.gan.regularise import STEP, blur, roughness
from mesoshell.train.gan.state import start
from mesoshell.train.patch_renderer import PictureConfig, material_of
from tests.helpers import small_step


def test_blur_is_scipys_and_none_at_zero() -> None:
    y = np.random.default_rng(0).normal(size=(2, 24, 24, 3)).astype(np.float32)
    found = blur(jnp.asarray(y), jnp.float32(1.3), 2.0)
    expected = gaussian_filter(y, (0, 1.3, 1.3, 0), mode="nearest", truncate=6 / 1.3)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    np.testing.assert_allclose(blur(jnp.asarray(y), jnp.float32(0), 2.0), y, atol=1e-6)
    gradient = jax.grad(lambda s: jnp.sum(blur(jnp.asarray(y), s, 2.0) ** 2))(jnp.float32(0))
    assert np.isfinite(gradient)


def test_roughness_of_a_constant_density_is_zero_and_grows_with_slope() -> None:
    config = PictureConfig(8, 4, texels=16, height_rows=8, octaves=1)
    decoder = init_decoder(jax.random.key(0), 4 + 3, (4,), (4,))
    flat = jax.tree.map(jnp.zeros_like, decoder)._replace(scale=jnp.float32(30.0))

    @jax.jit
    def of(decoder, slope):
        ramp = slope * jnp.broadcast_to(jnp.arange(16.0)[None, :, None], (16, 16, 4)) / 16
        material = material_of(config, ramp, jnp.zeros((8, 4)), decoder)
        return roughness(config, material, jnp.zeros(0), jax.random.key(1))

    assert of(flat, 1.0) == 0
    trunk = [layer._replace(kernel=jnp.ones_like(layer.kernel).at[4:].set(0)) for layer in flat.trunk]
    sloped = flat._replace(trunk=trunk, sigma=flat.sigma._replace(kernel=jnp.ones_like(flat.sigma.kernel)))
    gentle, steep = of(sloped, 0.1), of(sloped, 0.2)
    assert 0 < gentle < steep < 100 * STEP


def test_views_of_one_texture_share_it_and_its_parameters() -> None:
    from mesoshell.train.gan.generate import conditions, generate

    config = replace(small_step.CONFIG, views=2)
    batch = jax.tree.map(lambda x: x if x.dtype == np.uint32 else jnp.float32(x), small_step.batch())
    wanted = conditions(config, batch)
    np.testing.assert_array_equal(wanted.alpha[1::2], batch.alpha[::2])
    np.testing.assert_array_equal(wanted.camera_to_world, batch.camera_to_world)
    same = wanted._replace(camera_to_world=jnp.repeat(batch.camera_to_world[::2], 2, axis=0))
    state = start(config, jax.random.key(0))
    pictures, _ = jax.jit(lambda s, b: generate(config, s.learner, s.averages, b, jax.vmap))(state, same)
    a, b, c = pictures[0], pictures[1], pictures[2]
    inside = np.asarray(a[..., 3] > 0)
    assert inside.any()
    near, far = np.abs(a - b)[inside].mean(), np.abs(a - c)[inside].mean()
    assert near < 0.5 * far  # they differ by where their samples lie, not by what is there
