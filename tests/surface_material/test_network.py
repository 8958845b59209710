"""The network of a surface material: its answers against float64, its blur, what it wraps, sees and does not see."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from mesoshell.io.surface import SurfaceBundle
from mesoshell.surface_material import network
from mesoshell.surface_material.loader import load_device_material, surface_of
from mesoshell.surface_material.network import (
    SurfaceConfig,
    SurfaceQuery,
    eval_opacity,
    init_surface,
    reflectance,
)
from tests.helpers import wearing

FORMS = ("direct", "cosine", "none")
blurred, blur_textures = jax.jit(network.blur_texture), jax.jit(network.blur_textures)


def asked(b: SurfaceBundle, q: dict[str, np.ndarray], surface=None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """α, c and ρ of queries by the network, its textures as they are."""
    made = load_device_material(b)
    table = made.table if surface is None else blur_textures(surface, jnp.float32(1e-3))
    low, high = b.curvature
    kappa = (2 * np.clip(q["kappa"], low, high) - low - high) / (high - low)

    def one(u, r, w, k, light):
        place = SurfaceQuery(u, r, w, k)
        found = eval_opacity(made.config, table, place)
        return found.alpha, found.cosine, reflectance(made.config, table, place, found, light)

    given = (jnp.asarray(x, jnp.float32) for x in (q["u"], q["r"], q["w"], kappa, q["light"]))
    alpha, cosine, rho = jax.jit(jax.vmap(one))(*given)
    return np.asarray(alpha), np.asarray(cosine), np.asarray(rho)


@pytest.mark.parametrize("n", [1, 2, 8, 32])
@pytest.mark.parametrize("deviation", [0.1, 0.7, 2.0, 8.0, 300.0])
def test_a_blur_is_a_gaussian_that_wraps(n: int, deviation: float) -> None:
    """Also one that is wider than the texture. The mean stays."""
    texture = np.random.default_rng(n).normal(size=(n, n, 2))
    found = np.asarray(blurred(jnp.asarray(texture, jnp.float32), jnp.float32(deviation)))
    wanted = gaussian_filter(texture, (deviation, deviation, 0), mode="wrap", truncate=9.0)
    np.testing.assert_allclose(found, wanted, atol=2e-6)
    np.testing.assert_allclose(found.mean(axis=(0, 1)), texture.mean(axis=(0, 1)), atol=1e-6)


def test_no_blur_is_the_texture_and_a_blur_moves_with_it() -> None:
    texture = jnp.asarray(np.random.default_rng(0).normal(size=(16, 16, 3)), jnp.float32)
    np.testing.assert_array_equal(blurred(texture, jnp.float32(1e-3)), texture)
    moved = blurred(jnp.roll(texture, (3, 5), axis=(0, 1)), jnp.float32(1.5))
    np.testing.assert_allclose(moved, jnp.roll(blurred(texture, jnp.float32(1.5)), (3, 5), axis=(0, 1)), atol=1e-6)


def test_every_level_is_blurred_by_itself() -> None:
    """By as many of its own texels."""
    surface = init_surface(SurfaceConfig(8, 2, (4,)), jax.random.key(0))
    table = blur_textures(surface, jnp.float32(1.3))
    for pyramid, module in zip(table.pyramids, surface, strict=True):
        levels = [
            gaussian_filter(np.asarray(x, np.float64), (1.3, 1.3, 0), mode="wrap", truncate=9.0) for x in module.texture
        ]
        np.testing.assert_allclose(pyramid.rows, np.concatenate([x.reshape(-1, 2) for x in levels]), atol=1e-6)


@pytest.mark.parametrize("opacity", FORMS)
@pytest.mark.parametrize("curvature", [True, False])
def test_answers_are_those_of_the_files_description(opacity: str, curvature: bool) -> None:
    """Of all kinds of queries, in float64; a step and an offset of a file's own count."""
    b = wearing.bundle(opacity=opacity, sees_curvature=curvature, hidden=(8, 6), step=0.05, offset=0.3)
    q = wearing.queries(2000)
    alpha, cosine, rho = asked(b, q)
    wanted = wearing.answers(b, **q)
    if opacity != "none":
        assert wanted[0].std() > 0.1
    assert wanted[2].std() > 0.01 * wanted[2].mean() > 0
    np.testing.assert_allclose(alpha, wanted[0], atol=2e-4)
    np.testing.assert_allclose(cosine, wanted[1], atol=1e-5)
    np.testing.assert_allclose(rho, wanted[2], rtol=1e-3, atol=1e-4 * wanted[2].max())


def test_places_wrap_around() -> None:
    """By whole periods, whatever footprint; halves of one are other places."""
    b, q = wearing.bundle(), wearing.queries(500)
    q["u"] = np.round(q["u"] * 1024) / 1024  # what a whole number can be added to exactly
    away = np.random.default_rng(1).integers(-30, 30, (500, 2)).astype(np.float32)
    for one, other in zip(asked(b, q), asked(b, q | {"u": q["u"] + away}), strict=True):
        np.testing.assert_allclose(
            one, other, atol=1e-3
        )  # u′ is as exact as u is, and a texel's features are far apart
    half = asked(b, q | {"u": q["u"] + np.float32(0.5)})
    assert np.abs(half[0] - asked(b, q)[0]).mean() > 0.03


def test_without_curvature_it_is_not_seen() -> None:
    for sees in (False, True):
        b, q = wearing.bundle(sees_curvature=sees), wearing.queries(300)
        flat, bent = (asked(b, q | {"kappa": np.full(300, k, np.float32)}) for k in (-1.0, 2.0))
        apart = [np.abs(x - y).max() for x, y in zip(flat, bent, strict=True)]
        assert (apart[0] > 0.01 and apart[2] > 1e-3) if sees else max(apart) == 0


def test_a_silhouette_cosine_is_where_opacity_steps() -> None:
    """α is ½ at c, and what it is elsewhere depends on how far off that is alone."""
    b, q = wearing.bundle(opacity="cosine"), wearing.queries(400)
    for name in list(b.arrays):  # ω would move c
        if name == "opacity/hidden/0/kernel":
            b.arrays[name][3:6] = 0
    b.arrays["opacity/last/bias"][:] += 4
    _, c, _ = asked(b, q)
    assert c.std() > 0.05
    for off in (-0.05, -0.01, 0.0, 0.01, 0.05):
        z = np.clip(c + off, 0.01, 0.999)
        w = np.stack([np.sqrt(1 - z * z), 0 * z, z], axis=1).astype(np.float32)
        alpha, again, _ = asked(b, q | {"w": w})
        np.testing.assert_allclose(again, c, atol=1e-6)
        np.testing.assert_allclose(alpha, 1 / (1 + np.exp(-(z - c) / 0.01)), atol=1e-3)


def test_several_lights_share_what_is_seen() -> None:
    """`eval_opacity` once, `reflectance` for each light, as the renderers do: each light's ρ is its own, and α is the same."""
    b, q = wearing.bundle(), wearing.queries(200)
    made, lights = load_device_material(b), wearing.directions(np.random.default_rng(2), 5).astype(np.float32)
    kappa = (2 * np.clip(q["kappa"], -1, 2) - 1) / 3

    def one(u, r, w, k):
        place = SurfaceQuery(u, r, w, k)
        found = eval_opacity(made.config, made.table, place)
        return found.alpha, jax.vmap(lambda l: reflectance(made.config, made.table, place, found, l))(lights)

    alpha, rho = jax.jit(jax.vmap(one))(*(jnp.asarray(x, jnp.float32) for x in (q["u"], q["r"], q["w"], kappa)))
    for k, light in enumerate(lights):
        wanted = wearing.answers(b, **(q | {"light": np.tile(light, (200, 1))}))
        np.testing.assert_allclose(alpha, wanted[0], atol=1e-4)
        np.testing.assert_allclose(rho[:, k], wanted[2], rtol=1e-3, atol=1e-4 * wanted[2].max())
    assert np.asarray(rho).std(axis=1).mean() > 1e-3


@pytest.mark.parametrize("opacity", FORMS)
def test_extremes_are_finite_and_so_are_their_gradients(opacity: str) -> None:
    """Footprints of nothing, of everything and of none; directions along the surface; both ends of curvature."""
    b = wearing.bundle(opacity=opacity)
    config, surface = load_device_material(b).config, surface_of(b)
    radius = jnp.array([0.0, 1e-42, 1e-3, 1e30, jnp.inf, jnp.nan], jnp.float32)
    flat = jnp.array([[1.0, 0, 0], [0, -1, 1e-3], [0.6, 0, 0.8], [0, 0, 1]], jnp.float32)
    grid = [x.reshape(-1) for x in jnp.meshgrid(jnp.arange(6), jnp.arange(4), jnp.array([-1.0, 1.0]), indexing="ij")]

    def answered(surface):
        table = blur_textures(surface, jnp.float32(0.5))

        def one(i, j, kappa):
            place = SurfaceQuery(jnp.array([1e4, -0.25], jnp.float32), radius[i], flat[j], kappa)
            found = eval_opacity(config, table, place)
            return found.alpha, reflectance(config, table, place, found, -flat[j])

        return jax.vmap(one)(*grid)

    alpha, rho = jax.jit(answered)(surface)
    assert np.isfinite(alpha).all() and np.isfinite(rho).all()
    assert (np.asarray(alpha) >= 0).all() and (np.asarray(alpha) <= 1).all() and (np.asarray(rho) >= 0).all()
    gradient = jax.jit(jax.grad(lambda s: sum(x.sum() for x in answered(s))))(surface)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(gradient))
    by_radius = np.asarray(rho).reshape(6, -1)
    np.testing.assert_array_equal(by_radius[[1, 5]], by_radius[[0, 0]])  # nothing, as none: the finest level
    np.testing.assert_array_equal(by_radius[4], by_radius[3])
    assert np.abs(by_radius[3] - by_radius[0]).max() > 1e-3


@pytest.mark.parametrize("opacity", FORMS)
def test_gradients_are_slopes(opacity: str) -> None:
    """Of a sum of all answers by all weights and texels along a direction: against differences of the float64 answers."""
    b, q = wearing.bundle(opacity=opacity, step=0.2), wearing.queries(64)
    low, high = b.curvature
    kappa = (2 * np.clip(q["kappa"], low, high) - low - high) / (high - low)
    config, random = load_device_material(b).config, np.random.default_rng(5)
    # in float64, of which a bundle holds halves
    along = {k: random.normal(size=x.shape) for k, x in b.arrays.items()}
    weight = random.normal(size=(3, 64))

    def total(h: float) -> float:
        moved = {k: x.astype(np.float64) + h * along[k] for k, x in b.arrays.items()}
        alpha, cosine, rho = wearing.answers(replace(b, arrays=moved), **q)
        return float((weight * np.stack([alpha, cosine, rho.sum(axis=1)])).sum())

    def ours(surface):
        table = blur_textures(surface, jnp.float32(1e-3))

        def one(u, r, w, k, light):
            place = SurfaceQuery(u, r, w, k)
            found = eval_opacity(config, table, place)
            return found.alpha, found.cosine, reflectance(config, table, place, found, light).sum()

        given = (jnp.asarray(x, jnp.float32) for x in (q["u"], q["r"], q["w"], kappa, q["light"]))
        return (jnp.asarray(weight, jnp.float32) * jnp.stack(jax.vmap(one)(*given))).sum()

    surface = surface_of(b)
    direction = surface_of(replace(b, arrays={k: x.astype(np.float32) for k, x in along.items()}))
    value, slope = jax.jit(lambda s, d: jax.jvp(ours, (s,), (d,)))(surface, direction)
    np.testing.assert_allclose(value, total(0.0), rtol=1e-4)
    back = jax.jit(jax.grad(ours))(surface)
    dots = (jnp.sum(x * y) for x, y in zip(*map(jax.tree.leaves, (back, direction)), strict=True))
    np.testing.assert_allclose(sum(dots), slope, rtol=1e-4)
    h = 1e-7
    np.testing.assert_allclose(slope, (total(h) - total(-h)) / (2 * h), rtol=1e-3)


def test_a_surface_begins_opaque_and_dim() -> None:
    config = SurfaceConfig(8, 3, (8,))
    table = blur_textures(init_surface(config, jax.random.key(1)), jnp.float32(1e-3))
    q = wearing.queries(200)

    def one(u, r, w, light):
        place = SurfaceQuery(u, r, w, jnp.float32(0.3))
        found = eval_opacity(config, table, place)
        return found.alpha, reflectance(config, table, place, found, light)

    alpha, rho = jax.jit(jax.vmap(one))(*(jnp.asarray(q[k]) for k in ("u", "r", "w", "light")))
    assert (alpha > 0.6).all() and (rho > 0).all() and (rho < 1).all()
