"""What a surface sends on: energy, reciprocity, closed forms, and finite gradients everywhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.neutex.brdf import MIN_ROUGHNESS, Lobes, shade

UNIT = st.tuples(*[st.floats(-1, 1, width=32)] * 3).filter(lambda u: np.linalg.norm(u) > 0.1)
#: A direction from a surface on: cosine to the normal, and azimuth.
OUTWARD = st.tuples(st.floats(0.02, 1), st.floats(-np.pi, np.pi))
UP = jnp.array([0.0, 0.0, 1.0])
SUM = jax.jit(jax.value_and_grad(lambda of, n, v, l: shade(of, n, v, l).sum(), argnums=(0, 1, 2, 3)))
SHADE = jax.jit(shade)


def unit(x) -> jax.Array:
    return jnp.asarray(np.asarray(x) / np.linalg.norm(x), jnp.float32)


def outward(n, cosine: float, azimuth: float) -> jax.Array:
    """A unit vector at an angle to another."""
    n = np.asarray(n, np.float64) / np.linalg.norm(n)
    a = np.cross(n, np.eye(3)[np.abs(n).argmin()])
    a /= np.linalg.norm(a)
    ring = np.cos(azimuth) * a + np.sin(azimuth) * np.cross(n, a)
    return unit(cosine * n + np.sqrt(1 - cosine**2) * ring)


def of(albedo: float, roughness: float, specular: float) -> Lobes:
    return Lobes(jnp.full(3, albedo), jnp.asarray(roughness), jnp.asarray(specular))


def directions(n: int) -> np.ndarray:
    """A spiral over the upper half sphere, each of the same solid angle."""
    z, turn = (np.arange(n) + 0.5) / n, np.arange(n) * np.pi * (3 - 5**0.5)
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1).astype(np.float32)


@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.1])
def test_white_sends_all_of_it_on(cosine) -> None:
    """Without a glossy part: f₀ = 0 leaves Schlick's rim, so the same without albedo is taken off."""
    light = directions(20000)
    v = jnp.array([np.sqrt(1 - cosine**2), 0.0, cosine], jnp.float32)
    white, rim = (
        jax.vmap(lambda l, a=a: shade(of(a, 1.0, 0.0), UP, v, l))(jnp.asarray(light))[:, 0] for a in (1.0, 0.0)
    )
    assert float((white - rim).mean() * 2 * np.pi) == pytest.approx(1, rel=1e-3)
    assert float(rim.min()) >= 0


@pytest.mark.parametrize("roughness", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("cosine", [1.0, 0.7, 0.3])
def test_gloss_sends_on_no_more_than_there_is(roughness, cosine) -> None:
    """f₀ = 1, no diffuse part: at most all, and nearly all where the surface is smooth."""
    v = jnp.array([np.sqrt(1 - cosine**2), 0.0, cosine], jnp.float32)
    light = jnp.asarray(directions(400000 if roughness < 0.2 else 50000))
    sent = float(jax.vmap(lambda l: shade(of(0.0, roughness, 1.0), UP, v, l))(light)[:, 0].mean() * 2 * np.pi)
    assert sent <= 1.01
    if roughness <= 0.3:
        assert sent > 0.93


@given(UNIT, OUTWARD, OUTWARD, st.floats(0, 1), st.floats(0, 1))
def test_it_is_reciprocal_but_for_the_cosine(n, v, l, roughness, specular) -> None:
    n, v, l = unit(n), outward(n, *v), outward(n, *l)
    assert min(float(n @ v), float(n @ l)) > 0.0199
    made = of(0.3, roughness, specular)
    a, b = SHADE(made, n, v, l) / (n @ l), SHADE(made, n, l, v) / (n @ v)
    np.testing.assert_allclose(a, b, rtol=2e-3)


@given(UNIT, UNIT, UNIT, st.sampled_from([0.0, 1e-6, MIN_ROUGHNESS, 0.5, 1.0]))
def test_values_and_gradients_are_finite(n, v, l, roughness) -> None:
    value, slope = SUM(of(0.5, roughness, 0.04), unit(n), unit(v), unit(l))
    assert bool(jnp.isfinite(value)) and float(value) >= 0
    assert all(bool(jnp.isfinite(x).all()) for x in jax.tree.leaves(slope))


def test_opposite_directions_and_a_flash_are_finite() -> None:
    for v, l in ((UP, -UP), (UP, UP), (-UP, -UP)):
        slope = jax.grad(lambda n, v, l: shade(of(0.5, 0.2, 0.04), n, v, l).sum())(UP, v, l)
        assert bool(jnp.isfinite(slope).all())
    assert float(shade(of(1.0, 1.0, 0.0), UP, UP, UP)[0]) == pytest.approx(1 / np.pi, rel=1e-5)
    assert float(shade(of(1.0, 0.5, 0.04), UP, UP, -UP).sum()) == 0
