"""The 21 hard cases in numbers: what a plain form loses on the inputs of `tests/stability`, and what ours does.

    python -m benchmarks.hard_cases [--out docs/results/stability.md]

Prints a row a case, or writes them into a page between its two marks; ends with status 1 if a limit is broken. The tests try
more than one input each, gradients among them, and the path tracer.
"""

import argparse
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mpmath
import numpy as np

import mesoshell
from mesoshell.geometry.mesh import uv_stretch
from mesoshell.geometry.normals import face_normals
from mesoshell.geometry.principal_curvature import principal
from mesoshell.io.bundle import read_bundle
from mesoshell.numerics import opacity, optical_depth, softplus
from mesoshell.render.composite import weights
from mesoshell.render.cone import cone_gaussian
from mesoshell.shell.generator.discriminator import DiscriminatorConfig, discriminate, init_discriminator
from mesoshell.shell.geometry import batched_walk, tracer
from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.shell.material.loader import decoder_of
from mesoshell.shell.material.precision import decoder_error
from mesoshell.shell.render.renderer import accumulate
from mesoshell.signal.fourier import draw_frequencies, fourier_map
from mesoshell.stability.prisms import least_jacobian
from mesoshell.texture import mip
from mesoshell.train.losses import r1
from tests.helpers import scenes
from tests.helpers.stability import dr_march
from tests.helpers.stability.extremes import (
    LENGTHS,
    POINTS,
    SIGMAS,
    STEPS,
    depths,
    true_opacity,
    true_softplus,
    true_sums,
)
from tests.helpers.stability.hard_rays import BAD, FAR, OFFSETS, TOWARD, grazed_sides, mirrored, sides, surface, targets
from tests.helpers.stability.oracles import locate, mp_leave_side, span_of_convex, total_length
from tests.helpers.stability.sides import leave_sides
from tests.helpers.stability.surfaces import ball, rays_at, torus, unit
from tests.stability import test_anisotropic_footprint as horizon
from tests.stability import test_cone_gaussian as cone
from tests.stability import test_degenerate_triangles as slivers
from tests.stability import test_radiometric_laws as laws
from tests.stability import test_seams_and_mirrors as seams
from tests.stability import test_white_furnace as furnace

MARKS = "<!-- cases -->", "<!-- end of cases -->"


class Row(NamedTuple):
    """tried: the inputs; what: is measured; naive: the worst of a textbook's form, or of ours without its remedy; limit: that
    the tests hold."""

    case: int
    name: str
    tried: str
    oracle: str
    what: str
    naive: float
    ours: float
    limit: float
    engine: str = "JAX"


def near_planar() -> Iterator[Row]:
    given = [np.concatenate(x) for x in zip(*(sides(kind) for kind in ("equal", "twisted")), strict=True)]
    d, p, n = given
    a = np.einsum("ri,ri->r", d, np.cross(p[:, 1] - p[:, 0], n[:, 1] - n[:, 0]))
    c, last = (np.einsum("ri,ri->r", d, np.cross(p[:, k], n[:, k])) for k in (0, 1))
    b = last - c - a
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (-b + np.sqrt(b * b - 4 * a * c)) / (2 * a)
    exact = _exact(d, p, n)
    said = "near-planar sides", "600 sides, twisted by 0 or 1e-6", "mpmath", "share missed, or off by 0.01"
    for engine, leave in (("JAX", leave_sides), ("Mitsuba", dr_march.leave_sides)):
        found = leave(d, p, n)
        missed = (found.inside < 0) | (np.abs(found.u - exact[2]) > 0.01)
        yield Row(1, *said, float((~(np.abs(u - exact[2]) < 0.01)).mean()), float(missed.mean()), 0, engine)


def grazing() -> Iterator[Row]:
    d, p, n = grazed_sides(1e-5, 0.5, np.random.default_rng(2))
    hit, _, u, h = _exact(d, p, n)
    said = "grazing rays", f"{len(d)} rays at 1e-5 to a twisted side", "mpmath", "wrong by 1e-3 and not in doubt"
    found = leave_sides(d, p, n)
    wrong = ((found.inside >= 0) != hit) | (hit & (np.maximum(abs(found.u - u), abs(found.h - h)) > 1e-3))
    yield Row(2, *said, float(wrong.sum()), float((wrong & ~found.doubt).sum()), 0)
    found = dr_march.leave_sides(d, p, n)
    off = ((found.inside >= 0) != hit) | (hit & (np.maximum(abs(found.u - u), abs(found.h - h)) > 1e-3))
    yield Row(2, *said, float(wrong.sum()), float((off & (np.abs(found.inside) > found.margin)).sum()), 0, "Mitsuba")


def far_origin() -> Iterator[Row]:
    rng = np.random.default_rng(7)
    foot = (OFFSETS[-1] * TOWARD + rng.uniform(-1, 1, (300, 2, 3))).astype(np.float32)
    post = (0.3 * unit(rng.normal(size=(300, 2, 3)))).astype(np.float32)
    u, h = rng.uniform(0.05, 0.95, (2, 300, 1))
    at = (1 - u) * (foot[:, 0] + h * post[:, 0]) + u * (foot[:, 1] + h * post[:, 1])
    d = unit(np.cross(foot[:, 1] - foot[:, 0].astype(np.float64), post[:, 0])).astype(np.float32)
    o = (at - 2 * d).astype(np.float32)
    p = foot - o[:, None]
    hit, _, exact, _ = _exact(d, p, post)
    f = [_dot(d, np.cross(foot[:, k], post[:, k])) - _dot(d, np.cross(o, post[:, k])) for k in (0, 1)]
    e, m = foot[:, 1] - foot[:, 0], post[:, 1] - post[:, 0]
    a = _dot(d, np.cross(e, m))
    b = f[1] - f[0] - a
    with np.errstate(all="ignore"):
        naive = np.abs((-b + np.sqrt(b * b - 4 * a * f[0])) / (2 * a) - exact)
    naive = np.where(np.isfinite(naive), naive, 1.0)
    said = "far from the origin", "300 sides 1e5 away, 1 wide", "mpmath", "u along the side"
    found = leave_sides(d, p, post)
    sure = hit & ~found.doubt
    yield Row(3, *said, float(min(naive[sure].max(), 1)), float(np.abs(found.u - exact)[sure].max()), 1e-3)
    found = dr_march.leave_sides(d, p.astype(np.float64), post)
    yield Row(3, *said, float(min(naive[hit].max(), 1)), float(np.abs(found.u - exact)[hit].max()), 1e-9, "Mitsuba")


def shared_edges() -> Iterator[Row]:
    for name, radius, centre, limit in (("shared edges", 1.0, (0.0, 0.0, 0.0), 0.0), ("… far away", 16.0, FAR, 2e-5)):
        said = name, "20 000 rays at vertices, posts and edges", "convex polyhedra", "share that leak"
        ours = _leaks(radius, centre)
        whole = batched_walk.visit
        tracer.visit = lambda prisms, starts, exact=False: (batched_walk._visit(prisms, starts, np.float32), 0)
        naive = _leaks(radius, centre)
        tracer.visit = whole
        yield Row(4, *said, naive, ours, limit)


def degenerate_triangles() -> Iterator[Row]:
    rng, naive, ours = np.random.default_rng(0), 0.0, 0.0
    for exponent in range(-8, 0):
        a, b, w = rng.normal(size=(3, 3))
        sliver = np.stack([a, b, 0.5 * (a + b) + 10.0**exponent * w]).astype(np.float32)
        if slivers.relative_height(sliver) <= 1e-9:
            continue
        exact, (i, j, k) = slivers.exact_normal(sliver), sliver
        flat = np.cross(i, j) + np.cross(j, k) + np.cross(k, i)
        naive = max(naive, float(np.abs(flat / max(np.linalg.norm(flat), 1e-30) - exact).max()))
        ours = max(ours, float(np.abs(face_normals(sliver.astype(np.float64), np.arange(3)[None])[0] - exact).max()))
    yield Row(5, "slivers", "heights from 1e-8 of the longest edge on", "mpmath", "normal", naive, ours, 1e-6)


def folds() -> Iterator[Row]:
    mesh = surface(lambda x, y: 2 * x * x)
    shell = extrude(mesh, 0.8, uv_stretch(mesh))
    asked = replace(shell, offset=np.float32(0.8) * mesh.normals)
    naive, ours = ((least_jacobian(x) <= 0).sum() for x in (asked, shell))
    said = "folded prisms", "a groove, thrice as thick as its radius", "det ∂P/∂ξ in float64", "prisms that fold"
    yield Row(6, *said, float(naive), float(ours), 0, "both")


def reentry() -> Iterator[Row]:
    mesh, count = torus(), 200
    shell = extrude(mesh, 0.12, 1.0)
    rng = np.random.default_rng(8)
    chosen = rng.integers(0, len(mesh.vertices), count)
    n = mesh.normals[chosen].astype(np.float64)
    d = unit(np.cross(n, rng.normal(size=n.shape)) - 0.05 * n)
    o = mesh.vertices[chosen] + 0.1 * n - 3 * d
    trace = Boundary(shell, mesh.faces).trace(o, d)
    t, step = (np.arange(4000) + 0.5) * 8 / 4000, 8 / 4000
    held = [locate(shell, o[r] + t[:, None] * d[r]).any(axis=1) & (t < trace.end[r]) for r in range(count)]
    true = np.array([inside.sum() * step for inside in held])
    i, first, last = trace.intervals, np.full(count, np.inf), np.zeros(count)
    np.minimum.at(first, i.ray, i.t0)
    np.maximum.at(last, i.ray, i.t1)
    naive = np.abs(np.maximum(last - first, 0) - true).max()
    said = "re-entry", "200 rays along a torus", "4000 points a ray", "length in the shell (plain: from first to last)"
    yield Row(7, *said, float(naive), float(np.abs(total_length(trace, count) - true).max()), 2 * step)


def degenerate_rays() -> Iterator[Row]:
    mesh = ball(1)
    boundary = Boundary(extrude(mesh, 0.2, 1.0), mesh.faces)
    o, d = (np.array([x[k] for x in BAD.values()], float) for k in (0, 1))
    trace = boundary.trace(o, d)
    with np.errstate(all="ignore"):
        flat = _dot(boundary.normal[0], boundary.corners[0, 0] - o) / (d @ boundary.normal[0])
    wrong = len(trace.intervals.ray) + np.isfinite(trace.end).sum()
    said = "rays that are none", "zero, infinite, NaN: 9 of them", "a miss", "answers that are none"
    yield Row(8, *said, float((~np.isfinite(flat)).sum()), float(wrong), 0)


def seams_and_mirrors() -> Iterator[Row]:
    worst = max(float(np.abs(seams.jumps(mesh, 12)[0]).max()) for mesh in (seams.WAVY, mirrored(seams.WAVY)))
    said = "seams, mirrored charts", "3000 rays through a wavy sheet", "the mesh's UV", "jump of (u, v, h) at an edge"
    yield Row(9, *said, np.nan, worst, 1e-5)


def extinction() -> Iterator[Row]:
    sigma, t = (x.ravel().astype(np.float32) for x in np.meshgrid([s for s in SIGMAS if 0 < s < np.inf], LENGTHS))
    exact = np.array([float(true_opacity(float(a), float(b))[0]) for a, b in zip(sigma, t, strict=True)])
    naive, ours = 1 - np.exp(-sigma * t), np.asarray(opacity(optical_depth(jnp.asarray(sigma), jnp.asarray(t))))
    some = exact > 1e-35
    naive, ours = (float(np.abs(x / exact - 1)[some].max()) for x in (naive, ours))
    yield Row(10, "extinction 1e-30 to 1e7", "36 values of σ and t", "mpmath", "opacity, relative", naive, ours, 1e-6)


def transmittance() -> Iterator[Row]:
    tau = depths(300.0, 3)
    depth, naive, true = np.zeros(1), np.float32(1), true_sums(tau)[-1]
    for some in np.split(tau, STEPS // 8):
        depth = accumulate(depth, np.zeros(8, int), some)[-1]
        for x in some:
            naive *= np.exp(-x)
    said = "thousands of steps", f"{STEPS} steps, τ = 300 in all", "mpmath", "log T, relative"
    yield Row(11, *said, abs(np.log(naive) + true) / true if naive > 0 else np.inf, abs(depth[0] - true) / true, 1e-12)


def exponentials() -> Iterator[Row]:
    true = true_softplus(POINTS)
    with np.errstate(over="ignore"):
        naive = np.log(1 + np.exp(POINTS)).astype(np.float64)
    ours = np.asarray(softplus(jnp.asarray(POINTS)))
    some = true > 1e-37
    off = [float(np.abs(x[some] / true[some] - 1).max()) for x in (naive, ours)]
    yield Row(12, "softplus at ±1e4", f"{len(POINTS)} values", "mpmath", "relative", *off, 1e-6)


def phases() -> Iterator[Row]:
    rate, at = 64, 4096 * 64
    rng = np.random.default_rng(0)
    f, phase = draw_frequencies(rng, 64, 4.0, 32.0), rng.uniform(size=(1, 1, 64)).astype(np.float32)
    none = jnp.zeros((0, 2), jnp.int32)
    found = fourier_map(jnp.asarray(f), none, jnp.asarray(phase), jnp.array([at, at], jnp.int32), (1, 1), rate)[0, 0, 0]
    x = (np.float32(at) + np.float32(0.5)) / np.float32(rate)
    naive = np.sin(np.float32(2 * np.pi) * ((f / 2**16).astype(np.float32) @ np.array([x, x]) + phase[0, 0]))
    with mpmath.workdps(60):
        place = mpmath.mpf(2 * at + 1) / (2 * rate)
        turns = [place * int(a + b) / 2**16 + mpmath.mpf(float(c)) for (a, b), c in zip(f, phase[0, 0], strict=True)]
        true = np.array([float(mpmath.sin(2 * mpmath.pi * turn)) for turn in turns])
    off = [float(np.abs(np.asarray(v) - true).max()) for v in (naive, found)]
    yield Row(13, "phases 4096 patches away", "64 frequencies up to 32", "mpmath", "sine", *off, 2e-6)


def mip_levels() -> Iterator[Row]:
    r = np.array([0, 1e-45, 1e-38, -1.0, np.nan, 1e-3, 1e30, 3e38, np.inf], np.float32)
    with np.errstate(all="ignore"):
        naive = np.log2(2 * r * np.float32(256))
    ours = np.asarray(jax.vmap(lambda r: mip.level_of(r, 256.0, 8))(r))
    bad = [float((~((x >= 0) & (x <= 8))).sum()) for x in (naive, ours)]
    yield Row(14, "mip levels", "9 footprints: 0, denormal, NaN, ∞ …", "0 to 8", "levels that there are not", *bad, 0)


def horizons() -> Iterator[Row]:
    uv = np.random.default_rng(4).uniform(size=(horizon.PLACES, 2)).astype(np.float32)
    feature, f = horizon.texture(0.0), horizon.at_horizon(1.0, 8.0)
    true = horizon.supersampled(feature, uv, f)
    off = [float(np.sqrt(np.mean((horizon.filtered(feature, uv, f, n) - true) ** 2))) for n in (1, 16)]
    said = (
        "the horizon",
        "footprints 8 : 1, 1 degree above it",
        "4096 taps",
        "filtered texture, of its deviation: 1 tap, 16",
    )
    yield Row(15, *said, *off, horizon.BOUND)


def cones() -> Iterator[Row]:
    naive = ours = 0.0
    for a, b in cone.SEGMENTS:
        t0, t1, r = np.float32(a), np.float32(b), np.float32(3e-3)
        middle, half = (float(np.float32(x)) for x in ((a + b) / 2, (b - a) / 2))
        true = np.array(cone.true_moments(max(middle - half, 0.0), middle + half, float(r)))
        found = np.array([float(x) for x in cone_gaussian(*map(jnp.float32, (middle, half, r)))])
        with np.errstate(all="ignore"):
            mean = np.float32(0.75) * (t1**4 - t0**4) / (t1**3 - t0**3)
            along = np.float32(0.6) * (t1**5 - t0**5) / (t1**3 - t0**3) - mean * mean
        off = abs(float(along) / true[1] - 1)
        naive = max(naive, off if np.isfinite(off) else np.inf)
        ours = max(ours, float(np.abs(found / true - 1).max()))
    said = "segments of a cone", f"{len(cone.SEGMENTS)}, some of no length", "mpmath", "variance along, relative"
    yield Row(16, *said, naive, ours, 2e-6)


def curvatures() -> Iterator[Row]:
    ico = ball(3)
    turned = np.round(8 * ico.vertices * 64) / 64
    far = replace(ico, vertices=(turned + 1e5).astype(np.float32))
    near = replace(ico, vertices=turned.astype(np.float32))
    v, f = far.vertices, ico.faces
    e = v[f[:, 1]] - v[f[:, 0]]
    normal = np.cross(v[f[:, 0]], v[f[:, 1]]) + np.cross(v[f[:, 1]], v[f[:, 2]]) + np.cross(v[f[:, 2]], v[f[:, 0]])
    sums = np.zeros_like(v)
    np.add.at(sums, f, normal[:, None])
    with np.errstate(all="ignore"):
        n = sums / np.linalg.norm(sums, axis=1, keepdims=True)
        naive = np.abs(_dot(n[f[:, 1]] - n[f[:, 0]], e) / _dot(e, e) - 1 / 8)
    ours = float(np.abs(principal(far).values - principal(near).values).max() * 8)
    said = "curvature", "a ball of radius 8, 1e5 away", "the same at the origin", "curvature, relative"
    yield Row(17, *said, float(np.nan_to_num(naive * 8, nan=np.inf).max()), ours, 1e-8, "both")


def penalties() -> Iterator[Row]:
    config = DiscriminatorConfig(16, 128, 8, embedding=8, labels=1)
    rng = np.random.default_rng(0)
    y, c = (jnp.asarray(rng.uniform(-1, 1, n), jnp.float32) for n in ((4, 16, 16, 3), (4, 1)))

    def penalty(key: jax.Array, dtype: Any) -> jax.Array:
        judge = init_discriminator(config, key)
        return r1(lambda y: discriminate(judge, y, c, None, dtype), y, 1.0)

    keys = jax.random.split(jax.random.key(2), 4)
    run: Callable = jax.jit(jax.vmap(penalty, in_axes=(0, None)), static_argnums=1)
    with jax.enable_x64(True):
        exact = np.asarray(run(keys, jnp.float64))
    off = [float(np.abs(np.asarray(run(keys, kind)) / exact - 1).max()) for kind in (jnp.bfloat16, jnp.float32)]
    yield Row(18, "R1", "4 discriminators: bfloat16, float32", "float64", "penalty, relative", *off, 1e-5)


def short_decoders() -> Iterator[Row]:
    grass = read_bundle(Path(mesoshell.__file__).parent / "assets/grass.npz")
    feature, height = (grass.arrays[name].astype(np.float32) for name in ("features/0", "height/0"))
    said = decoder_error(decoder_of(grass.arrays), feature, height, grass.height_octaves)
    tried = "grass, 8192 points: bfloat16, float16"
    off = [said[name]["sigma"]["rms"] for name in ("bfloat16", "float16")]
    yield Row(19, "networks in 16 bits", tried, "float64", "opacity, rms", *off, 5e-3, "both")


def white() -> Iterator[Row]:
    naive = ours = 0.0
    for cosine in furnace.COSINES:
        field = furnace.furnace(furnace.DENSE)
        tau = furnace.depths(field, cosine)
        light, solid = furnace.sphere()
        rho = solid @ np.asarray(furnace.reflected(field, cosine, light), np.float64)
        ours = max(ours, float(np.abs(float(weights(tau)[0].sum()) * rho - 1).max()))
        first = np.asarray(tau, np.float64)
        naive = max(naive, float(np.abs((np.exp(-(np.cumsum(first) - first)) * first).sum() * rho - 1).max()))
    said = "white furnace", "a dense field at 5 angles", "1", "radiance"
    yield Row(20, *said, naive, ours, 1e-3)


def radiometric() -> Iterator[Row]:
    grass = read_bundle(Path(mesoshell.__file__).parent / "assets/grass.npz")
    scene = scenes.slab(grass)
    scene = replace(scene, alpha=np.full(len(scene.device_material.names), 0.5, np.float32))
    a = laws.AFFINE["thickness 2"]
    base, offset = ((x @ a.T).astype(np.float32) for x in (scene.shell.base, scene.shell.offset))
    mapped = replace(
        scene, shell=replace(scene.shell, base=base, offset=offset), mesh=replace(scene.mesh, vertices=base)
    )
    aim = np.random.default_rng(3).uniform([0.02, 0.02, 0.3], [0.98, 0.98, 0.9], (300, 3))
    o, down = aim + np.array([0, 0, 3.0]), np.tile([0.0, 0, -1], (300, 1))
    once, twice = laws.depths(scene, o, down), laws.depths(mapped, o @ a.T, down)
    some = once > 1e-3
    off = [float(np.abs(x[some] / once[some] - 1).max()) for x in (2 * once, twice)]
    said = (
        "twice as thick a slab",
        "300 rays through grass",
        "the slab itself",
        "optical depth, relative (plain: world length)",
    )
    yield Row(21, *said, *off, 1e-4)


CASES = (
    near_planar,
    grazing,
    far_origin,
    shared_edges,
    degenerate_triangles,
    folds,
    reentry,
    degenerate_rays,
    seams_and_mirrors,
    extinction,
    transmittance,
    exponentials,
    phases,
    mip_levels,
    horizons,
    cones,
    curvatures,
    penalties,
    short_decoders,
    white,
    radiometric,
)


def _exact(d: np.ndarray, p: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, ...]:
    """Whether rays leave through sides, and t, u, h there, by mpmath."""
    hit, t, u, h = (np.array(x) for x in zip(*map(mp_leave_side, d, p, n), strict=True))
    return hit, t, u, h


def _leaks(radius: float, centre: tuple[float, float, float], count: int = 20_000) -> float:
    """Of rays at vertices, posts and edges of a ball's shell, the share whose length in it is wrong, or that pass the ball."""
    mesh = ball(2, radius, centre)
    shell = extrude(mesh, 0.2 * radius, radius)
    rng = np.random.default_rng(5)
    o, d = rays_at(targets(shell, count, rng), 3 * radius, rng)
    trace = Boundary(shell, mesh.faces).trace(o, d)
    enters, leaves = span_of_convex((shell.base.astype(np.float64) + shell.offset)[shell.faces], o, d)
    base = span_of_convex(shell.base[shell.faces].astype(np.float64), o, d)
    blocked, clear = base[1] - base[0] > 0, np.abs(base[1] - base[0]) > 1e-3 * radius
    length = np.maximum(np.where(blocked, base[0], leaves) - np.maximum(enters, 0), 0)
    wrong = (np.abs(total_length(trace, count) - length) > 1e-4 * radius) | (blocked != np.isfinite(trace.end))
    return float((wrong & clear).sum() / clear.sum())


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum(a * b, axis=-1)


def _number(x: float) -> str:
    if np.isnan(x):
        return "–"
    if np.isinf(x):
        return "∞"
    return f"{x:.0f}" if x == round(x) and abs(x) < 1e4 else f"{x:.1g}"


def table(rows: list[Row]) -> str:
    """Markdown."""
    lines = [
        "| | case | tried | oracle | error of | plain | ours | limit | engine |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        numbers = " | ".join(_number(x) for x in (r.naive, r.ours, r.limit))
        lines.append(f"| {r.case} | {r.name} | {r.tried} | {r.oracle} | {r.what} | {numbers} | {r.engine} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="page whose table is replaced")
    out = parser.parse_args().out
    rows = []
    for case in CASES:
        found = list(case())
        print("\n".join(table(found).splitlines()[2:]), flush=True)
        rows += found
    if out is not None:
        text = out.read_text()
        first, last = (re.escape(mark) for mark in MARKS)
        made = f"{MARKS[0]}\n{table(rows)}\n{MARKS[1]}"
        out.write_text(re.sub(f"{first}.*{last}", lambda _: made, text, flags=re.DOTALL))
    sys.exit(any(not row.ours <= row.limit for row in rows))


if __name__ == "__main__":
    main()
