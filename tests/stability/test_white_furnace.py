"""Hard case 20: under unit radiance from the whole sphere, a dense field with ρ = 1/4π returns 1 at every angle.

Oracle: ∫ ρ dω′ = 1, so a ray returns the probability that it collides: 1 where the field is dense, 1 − T where it is thin.
From the JAX engine's quadrature (weights along the ray, Gauss-Legendre × equal azimuths over the sphere), and from the free
flights and directions that the path tracer draws.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

import mesoshell.pathtracer  # noqa: F401  (it makes Mitsuba ready)
from mesoshell.geometry.mesh import check_mesh
from mesoshell.io.bundle import FADE, Bundle
from mesoshell.numerics import optical_depth
from mesoshell.pathtracer import scatter
from mesoshell.pathtracer.free_flight import Flight, fly
from mesoshell.pathtracer.material import Material
from mesoshell.pathtracer.media import Media, Medium
from mesoshell.pathtracer.render_context import RenderContext
from mesoshell.pathtracer.samples import Ray
from mesoshell.pathtracer.shells import Shells
from mesoshell.render.composite import weights
from mesoshell.render.effects import PATHS, plan_effects
from mesoshell.render.facts import Facts
from mesoshell.render.light import environment
from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.material.field import Field, Point
from mesoshell.shell.render.renderer import render
from tests.helpers import scenes

import drjit as dr  # isort: skip
import mitsuba as mi  # isort: skip

SAMPLES, DRAWS = 64, 40_000
XI = np.random.default_rng(7).random(DRAWS).astype(np.float32)
#: Of the path tracer: none of a ray's samples passed over.
EVEN = replace(scenes.FULL, samples=SAMPLES)
COSINES = [1.0, 0.7, 0.3, 0.1, 0.01]
DENSE, THIN = 200.0, 0.4


def furnace(sigma: float) -> Field:
    """A homogeneous medium that scatters alike in every direction."""
    return Field(
        density=lambda point: (jnp.float32(sigma) + 0 * point.radius, jnp.zeros(1)),
        transport=lambda found, w, w_light: jnp.full(3, 1 / (4 * np.pi)) + 0 * w_light,
    )


def depths(field: Field, cosine: float) -> jax.Array:
    """τ of samples along a ray through the unit slab."""
    length = 1 / cosine
    h = 1 - (jnp.arange(SAMPLES, dtype=jnp.float32) + 0.5) / SAMPLES
    xi = jnp.stack([0 * h, 0 * h, h], axis=1)
    sigma, _ = jax.vmap(field.density)(Point(xi, 0 * h, 0 * h, jnp.zeros((SAMPLES, 0))))
    return optical_depth(sigma, jnp.full(SAMPLES, length / SAMPLES, jnp.float32))


def viewer(cosine: float) -> jax.Array:
    return jnp.float32([np.sqrt(1 - cosine**2), 0, cosine])


def reflected(field: Field, cosine: float, light: np.ndarray) -> jax.Array:
    """ρ (M, 3) toward the viewer from the directions `light` (M, 3)."""
    return jax.vmap(field.transport, in_axes=(None, None, 0))(jnp.zeros(1), viewer(cosine), jnp.asarray(light))


def sphere() -> tuple[np.ndarray, np.ndarray]:
    """Directions over the whole sphere, and their shares of its solid angle."""
    z, share = np.polynomial.legendre.leggauss(16)
    phi = (np.arange(32) + 0.5) / 32 * 2 * np.pi
    s = np.sqrt(1 - z**2)[:, None]
    d = np.stack([s * np.cos(phi), s * np.sin(phi), np.broadcast_to(z[:, None], (16, 32))], axis=-1)
    return d.reshape(-1, 3).astype(np.float32), np.repeat(share * 2 * np.pi / 32, 32)


@pytest.mark.parametrize("sigma", [DENSE, THIN])
@pytest.mark.parametrize("cosine", COSINES)
def test_by_quadrature(sigma: float, cosine: float):
    field = furnace(sigma)
    w, through = weights(depths(field, cosine))
    light, solid = sphere()
    returned = float(w.sum()) * solid @ np.asarray(reflected(field, cosine, light), np.float64)
    np.testing.assert_allclose(returned, -np.expm1(-sigma / cosine), atol=1e-3 if sigma == DENSE else 1e-5)
    np.testing.assert_allclose(float(through), np.exp(-sigma / cosine), atol=1e-6)


@pytest.fixture(scope="module")
def plate():
    """A square of 2000 patches a side, which a ray of cosine 0.01 does not leave through an edge, and its shell of height 1."""
    corners = 1000 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Shells([extrude(check_mesh(corners, faces, corners[faces][..., :2], "plate"), 1.0, 1.0)])


def flown(
    plate: Shells, bundle: Bundle, cosine: float, shift: float = 0.5, xi: np.ndarray = XI
) -> tuple[Flight, RenderContext]:
    """The path tracer's flights of DRAWS rays of a cosine, to where they collide by the uniform numbers ξ."""
    plan = plan_effects(Facts(shells=1, environment=True, convex=True), EVEN, PATHS)
    context = RenderContext(plate, Media(plate, [Medium(Material(bundle), (0.5,))]), None, EVEN, plan)
    d = np.array([np.sqrt(1 - cosine**2), 0, -cosine])
    o, along = (mi.Vector3d(*map(float, x)) + dr.zeros(mi.Vector3d, DRAWS) for x in ((0.3, 0.2, 0) - 2 / cosine * d, d))
    far = dr.full(mi.Float64, 2 / cosine, DRAWS)  # the surface below
    ray = Ray(o, along, 0 * far, far, dr.full(mi.Bool, True, DRAWS), dr.full(mi.Float, 1e-3, DRAWS), 0 * mi.Float(far))
    return fly(context, ray, -dr.log(1 - mi.Float(xi)), dr.full(mi.Bool, True, DRAWS), shift), context


@pytest.mark.parametrize("sigma", [DENSE, THIN])
@pytest.mark.parametrize("cosine", COSINES)
def test_by_sampling(plate, tiny_bundle: Bundle, sigma: float, cosine: float):
    """Free flights, and directions of light, as the path tracer draws them. Its ρ fades out over FADE below the horizon: what
    returns all light is ρ = 1/2π(1 + FADE/2) above it."""
    flight, context = flown(plate, constant_bundle(tiny_bundle, sigma, 1 / (2 * np.pi * (1 + FADE / 2))), cosine)
    numbers = mi.Point2f(np.random.default_rng(8).random((2, DRAWS)).astype(np.float32))
    _, light, density = scatter.draw(flight.frame, numbers)
    _, features = context.media.decode(flight.sample)
    (rho,) = context.media.rho(flight.sample, features, mi.Vector3f(*map(float, viewer(cosine))), [light])
    collided, value = np.array(flight.collided), np.array(rho / density)
    each = np.where(collided, value, 0.0)
    spread = 4 * each.std(axis=1) / np.sqrt(DRAWS)
    assert (np.abs(each.mean(axis=1) + np.expm1(-sigma / cosine)) <= np.maximum(1e-3, spread)).all()
    escaped = np.exp(-sigma / cosine)
    np.testing.assert_allclose(1 - collided.mean(), escaped, atol=4 * np.sqrt(escaped / DRAWS) + 1e-9)


@pytest.mark.parametrize("shift", [0.5, 0.0, 0.9])
def test_collisions_have_density_t_sigma(plate, tiny_bundle: Bundle, shift: float):
    """How many rays collide at which of the samples, by Pearson's χ² (1 in 1000), with w of the quadrature."""
    sigma, cosine = 3.0, 0.7
    flight, _ = flown(plate, constant_bundle(tiny_bundle, sigma, 0.1), cosine, shift)
    depth = (1 - np.array(flight.sample.xi.z, np.float64)) * EVEN.samples
    k = np.rint(depth - shift).astype(int)
    collided = np.array(flight.collided)
    np.testing.assert_allclose(depth[collided], k[collided] + shift, atol=1e-3)
    found = np.append(np.bincount(k[collided], minlength=EVEN.samples), DRAWS - collided.sum())
    w, through = weights(jnp.full(EVEN.samples, sigma / cosine / EVEN.samples, jnp.float32))
    expected = DRAWS * np.append(np.asarray(w, np.float64), float(through))
    assert ((found - expected) ** 2 / expected).sum() < chi2.ppf(0.999, len(found) - 1)


def test_a_draw_at_the_ends_is_defined(plate, tiny_bundle: Bundle):
    """ξ = 0 collides at the first sample that holds something; nothing does where there is nothing, whatever ξ."""
    ends = np.resize(np.array([0, 1 - 2**-24], np.float32), DRAWS)
    flight, _ = flown(plate, constant_bundle(tiny_bundle, DENSE, 0.1), 0.5, xi=ends)
    assert np.array(flight.collided).all() and np.isfinite(np.array(flight.depth)).all()
    first = np.array(flight.sample.xi.z)[::2]
    np.testing.assert_allclose(first, 1 - 0.5 / EVEN.samples, atol=1e-5)
    flight, _ = flown(plate, constant_bundle(tiny_bundle, 1e-30, 0.1), 0.5, xi=ends)
    assert not np.array(flight.collided)[1::2].any() and (np.array(flight.depth) < 1e-28).all()


def constant_bundle(bundle: Bundle, sigma: float, rho: float) -> Bundle:
    """The bundle with a decoder that gives σ and ρ whatever it sees: softplus inverted into the two biases."""
    a = dict(bundle.arrays)
    for name, value, shift in (("sigma", sigma / float(a["sigma_scale"]), 3.0), ("rho", rho, 2.0)):
        a[f"decoder/{name}/kernel"] = np.zeros_like(a[f"decoder/{name}/kernel"])
        bias = shift + value + np.log(-np.expm1(-value))
        a[f"decoder/{name}/bias"] = np.full_like(a[f"decoder/{name}/bias"], bias)
    a |= {k: np.full_like(v, 2 * sigma) for k, v in a.items() if k.startswith("grid/")}
    return replace(bundle, arrays=a)


def test_through_the_whole_renderer(tiny_bundle: Bundle):
    """Light comes from above only, for a trained ρ fades below the horizon: ρ = 1/2π over the upper half sphere."""
    scene = scenes.slab(constant_bundle(tiny_bundle, DENSE, 1 / (2 * np.pi)))
    sky = np.zeros((16, 8, 3))
    sky[:8] = 1.0
    scene = replace(scene, lights=(), environment=environment(sky, 2), transparent=True)
    quality = replace(scenes.FULL, samples=64, environment_samples=64)
    image, _ = render(scene, quality, scenes.effects(scene, quality))
    inside = image[..., 3] > 0.999
    assert inside.sum() > 50
    np.testing.assert_allclose(image[inside][:, :3].mean(axis=0), 1.0, atol=1e-3)
    np.testing.assert_allclose(image[inside][:, :3], 1.0, atol=0.05)
