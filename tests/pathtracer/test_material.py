"""Filtered features, σ and ρ in Dr.Jit are those of the JAX engine, of textures that wrap, of textures with edges and of
corner tiles."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import jax
import jax.numpy as jnp
import mitsuba as mi
import numpy as np
import pytest

from mesoshell.io.bundle import Bundle, read_bundle
from mesoshell.io.corner_tiles import seed_origin
from mesoshell.pathtracer.material import Material
from mesoshell.pathtracer.samples import Sample
from mesoshell.shell.material.field import Point, neural_field
from mesoshell.shell.material.loader import load_device_material
from mesoshell.shell.render.kernels import DeviceTables, StaticConfig, _inputs, bound
from mesoshell.texture import mip
from mesoshell.texture.footprint import Footprint

GRASS = Path(__file__).parents[2] / "src" / "mesoshell" / "assets" / "grass.npz"


def with_edges(bundle: Bundle) -> Bundle:
    """The material on a texture of 1½ × 1 patches that has edges: half a patch more of the same."""
    arrays = dict(bundle.arrays)
    texels = int(bundle.texel_density)
    for i in range(texels.bit_length()):
        arrays[f"features/{i}"] = arrays.pop(f"features/{i}")
        side = arrays[f"features/{i}"].shape[0]
        arrays[f"features/{i}"] = np.concatenate([arrays[f"features/{i}"]] * 2)[: side + -(-side // 2)]
        grid, cells = arrays[f"grid/{i}"], min(8, max(1, texels >> i))
        arrays[f"grid/{i}"] = np.full((grid.shape[0], -(-3 * cells // 2), cells), grid.max())
    return Bundle(**{**vars(bundle), "arrays": arrays, "wraps": False})


def corrected(bundle: Bundle) -> Bundle:
    """The material with a correction, of numbers that mean nothing."""
    levels = sum(key.startswith("features/") for key in bundle.arrays)
    added = np.random.default_rng(5).normal(size=(levels, 7, bundle.channels)).astype(np.float16)
    return replace(bundle, arrays=bundle.arrays | {"correction": added})


@pytest.fixture(scope="module", params=["wraps", "edges", "tiles", "corrected"])
def bundle(request, tiled_bundle) -> Bundle:
    if request.param == "tiles":
        return tiled_bundle
    found = read_bundle(GRASS)
    return {"wraps": lambda x: x, "edges": with_edges, "corrected": corrected}[request.param](found)


@pytest.fixture(scope="module")
def points() -> dict[str, np.ndarray]:
    """Some beyond the texture's edges; footprints from nothing to more than a patch."""
    rng = np.random.default_rng(0)
    unit = rng.normal(size=(2, 3, 500))
    radius = np.exp(rng.uniform(-9, 1, 500)) * (rng.random(500) > 0.1)
    xi = rng.uniform([[-0.5], [-0.5], [0]], [[2.0], [2.0], [1]], (3, 500))
    toward = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    found = {"xi": xi, "radius": radius, "deviation": radius[::-1], "alpha": rng.random((1, 500))}
    return {k: v.astype(np.float32) for k, v in (found | {"w": toward[0], "light": toward[1]}).items()}


def test_features_and_density_and_transport(bundle, points) -> None:
    """To 1e-5 of the largest value."""
    made = load_device_material(bundle)
    field = neural_field(made.material, made.layout)

    def one(xi, radius, deviation, alpha, w, light):
        sigma, features = field.density(Point(xi, radius, deviation, alpha))
        return sigma, field.transport(features, w, light)

    rows = [jnp.asarray(points[k].T) for k in ("xi", "radius", "deviation", "alpha", "w", "light")]
    sigma, rho = jax.jit(jax.vmap(one))(*rows)
    material = Material(bundle)
    xi, w, light = (mi.Vector3f(points[k]) for k in ("xi", "w", "light"))
    radius, deviation = (mi.Float(points[k]) for k in ("radius", "deviation"))
    sample = Sample(mi.UInt32(0), mi.Float(0), xi, radius, deviation, mi.Float(0), mi.Vector2f(0))
    seen = material.inputs(sample, [mi.Float(points["alpha"][0])])
    ours, features = material.density_of(seen)
    our_rho = material.transport(list(features), w, light)
    np.testing.assert_allclose(np.array(ours), sigma, rtol=1e-4, atol=1e-5 * float(sigma.max()))
    np.testing.assert_allclose(np.array(our_rho).T, rho, rtol=1e-4, atol=1e-5 * float(rho.max()))


def test_bounds_are_the_grids(bundle, points) -> None:
    made, material = load_device_material(bundle), Material(bundle)
    program = StaticConfig(made.layout, made.grid_shapes, True, 1, False, ())
    last = len(made.layout.sizes) - 1

    def one(xi, radius):
        return bound(program, made.grid, xi, mip.level_of(radius, made.layout.texel_density, last))

    expected = jax.vmap(one)(jnp.asarray(points["xi"].T), jnp.asarray(points["radius"]))
    ours = material.bound(mi.Vector3f(points["xi"]), material.level(mi.Float(points["radius"])))
    assert (np.array(ours) == np.asarray(expected)).mean() > 0.995, "but for points on a cell's wall"


@pytest.mark.parametrize("radius", [0.0, 1e-42, np.inf, np.nan])
def test_any_footprint_has_a_level(bundle, radius) -> None:
    level = np.array(Material(bundle).level(dr.full(mi.Float, radius, 1)))
    assert 0 <= level[0] <= len(Material(bundle).plane.shapes) - 1


@pytest.mark.parametrize("seed", [0, 7])
@pytest.mark.parametrize(
    ("taps", "made_of"),
    [pytest.param(1, None, marks=pytest.mark.slow), pytest.param(4, None, marks=pytest.mark.slow), (4, corrected)],
)
def test_tiles_far_out_and_of_a_seed_are_those_of_the_other_engine(tiled_bundle, points, seed, taps, made_of) -> None:
    origin = seed_origin(seed)
    tiled = made_of(tiled_bundle) if made_of else tiled_bundle
    made, material = load_device_material(tiled, origin), Material(tiled, origin)
    random = np.random.default_rng(1)
    # eighths of a texel, which float32 has exactly that far out
    xi = np.vstack([random.integers(-4000 * 32, 4000 * 32, (2, 500)) / 32, random.random((1, 500))]).astype(np.float32)
    major, axis = 2 * points["radius"], random.normal(size=(2, 500)).astype(np.float32)
    axis /= np.linalg.norm(axis, axis=0)
    program = StaticConfig(made.layout, made.grid_shapes, True, taps, False, ())
    alpha = np.float32(points["alpha"][0, 0])
    nothing: Any = None  # is read of a chart, maps and the like
    table = DeviceTables(nothing, made.material, made.grid, jnp.full(1, alpha), nothing, nothing, nothing, nothing)

    def one(xi, radius, major, axis, deviation):
        return _inputs(program, table, xi, Footprint(radius, major, axis, deviation))

    rows = [jnp.asarray(x.T) for x in (xi, points["radius"], major, axis, points["deviation"])]
    expected = jax.jit(jax.vmap(one))(*rows)
    parts = (points["radius"], points["deviation"], major)
    radius, deviation, wide = (mi.Float(x) for x in parts)
    sample = Sample(mi.UInt32(0), mi.Float(0), mi.Vector3f(xi), radius, deviation, wide, mi.Vector2f(axis))
    ours = np.stack(
        [np.broadcast_to(np.array(x), 500) for x in material.inputs(sample, [mi.Float(float(alpha))], taps)]
    )
    off = np.abs(ours.T - np.asarray(expected)).max(axis=1)
    assert np.quantile(off, 0.99) < 2e-4, "taps that fall on a border may round to either side"


@pytest.mark.parametrize("taps", [0, 2, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 8))])
def test_a_correction_is_read_at_the_area_that_is_averaged(taps) -> None:
    """In both engines: its numbers are the levels themselves here, and features are 0. Without a filter there is none."""
    bundle = read_bundle(GRASS)
    levels = np.arange(9, dtype=np.float32)[:, None, None] * np.ones((9, 3, bundle.channels), np.float32)
    zero = {k: 0 * x for k, x in bundle.arrays.items() if k.startswith(("features/", "height/"))}
    made = replace(bundle, arrays=bundle.arrays | zero | {"correction": levels})
    minor, major = 2.0**-6, 2.0**-4
    between = {0: 0.0, 1: 0.0, 2: 2.0, 8: 4.6 / 8 / np.sqrt(np.dot(*_variance(8)))}[taps]
    s = minor if taps <= 1 else np.sqrt(major * max(minor, 0.35 * between * major))
    expected = 0.0 if taps == 0 else np.log2(2 * s * bundle.texel_density)
    xi, alpha = np.array([[0.3], [0.4], [0.5]], np.float32), 0.2
    sample = Sample(
        mi.UInt32(0), mi.Float(0), mi.Vector3f(xi), mi.Float(minor), mi.Float(0), mi.Float(major), mi.Vector2f(1, 0)
    )
    ours = Material(made).inputs(sample, [mi.Float(alpha)], taps)[: bundle.channels]
    np.testing.assert_allclose(np.array(ours).ravel(), expected, rtol=1e-5, atol=1e-6)
    loaded = load_device_material(made)
    nothing: Any = None
    program = StaticConfig(loaded.layout, loaded.grid_shapes, taps > 0, max(taps, 1), False, ())
    table = DeviceTables(nothing, loaded.material, loaded.grid, jnp.full(1, alpha, jnp.float32), *[nothing] * 4)
    footprint = Footprint(jnp.float32(minor), jnp.float32(major), jnp.array([1.0, 0.0]), jnp.float32(0))
    theirs = _inputs(program, table, jnp.asarray(xi[:, 0]), footprint)[: bundle.channels]
    np.testing.assert_allclose(theirs, expected, rtol=1e-5, atol=1e-6)


def _variance(taps: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights of taps, and squares of their places before these are scaled."""
    places = (np.arange(taps) + 0.5) / taps * 4.6 - 2.3
    weights = np.exp(-(places**2) / 2)
    return weights / weights.sum(), places**2
