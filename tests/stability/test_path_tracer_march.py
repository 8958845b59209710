"""Hard cases 2 to 9 through the path tracer's march; the oracles are those of the JAX engine's tests.

The surface underneath is met in Mitsuba's own scene, in float32: its distance is taken from the oracle, but where it is said.
"""

import mesoshell.pathtracer  # noqa: F401  isort: skip  (it makes Mitsuba ready)

from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from mesoshell.geometry.mesh import Mesh, load_mesh, uv_stretch
from mesoshell.pathtracer.prism import Piece
from mesoshell.pathtracer.samples import canonical_frame
from mesoshell.pathtracer.shells import Shells
from mesoshell.shell.geometry.extrude import Shell, extrude
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.stability.prisms import prism_point
from mesoshell.stability.rays import aim_rays
from tests.helpers.stability import dr_march
from tests.helpers.stability.dr_march import trace
from tests.helpers.stability.hard_rays import (
    BAD,
    FAR,
    OFFSETS,
    OVERLAPPING,
    PART,
    SCENES,
    SHIFT,
    TOWARD,
    assert_as_sampled,
    cylinder,
    grazing,
    mirrored,
    rays_through,
    targets,
)
from tests.helpers.stability.hard_rays import surface as grown_up
from tests.helpers.stability.oracles import (
    assert_ends_on_ray,
    locate,
    span_of_convex,
    total_length,
)
from tests.helpers.stability.surfaces import ball, plain, rays_at, sheet, torus, unit


def single(x: np.ndarray) -> np.ndarray:
    """Numbers as Mitsuba's rays have them."""
    return x.astype(np.float32).astype(np.float64)


def spans(shell: Shell, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, ...]:
    """Of a shell on a ball: where rays enter, leave, and meet the base (infinite for none); and by how much they are clear of
    touching it."""
    enters, leaves = span_of_convex((shell.base.astype(np.float64) + shell.offset)[shell.faces], o, d)
    base = span_of_convex(shell.base[shell.faces].astype(np.float64), o, d)
    end = np.where(base[0] < base[1], base[0], np.inf)
    return enters, leaves, end, np.abs(base[1] - base[0])


# --- 3: far from the origin


@pytest.mark.parametrize("offset", OFFSETS)
def test_a_ball_far_from_the_origin(offset: float) -> None:
    """The bound of the JAX engine, for rays whose origins are Mitsuba's: float32, in world space."""
    mesh = ball(2, 8.0, tuple(offset * TOWARD))
    shell = extrude(mesh, 2.0, 8.0)
    rng = np.random.default_rng(6)
    inside = shell.base[rng.integers(0, len(shell.base), 4000)] + 4 * rng.normal(size=(4000, 3))
    o, d = (single(x) for x in rays_at(inside, 20.0, rng))
    enters, leaves, end, clear = spans(shell, o, d)
    found = trace(Shells([shell]), o, d, end)
    assert_ends_on_ray(found, shell, o, d, 1e-9)
    length = np.maximum(np.minimum(leaves, end) - enters, 0)
    some = (enters > 0) & (clear > 1e-2)
    assert some.sum() > 1000
    np.testing.assert_allclose(total_length(found, 4000)[some], length[some], atol=1e-5)


def test_a_ray_is_much_the_same_from_however_far() -> None:
    """From 1000 sizes away, and begun near: the origins are points of the same rays in float64."""
    mesh = load_mesh(Path(__file__).parents[1] / "data" / "suzanne.obj")
    shell = extrude(mesh, 0.1, 0.1)
    far = aim_rays(shell, 4000, 1000.0, np.random.default_rng(2))
    along = 0.997 * np.nanmax(far.reach)
    there, here = (trace(Shells([shell]), far.o + x * far.d, far.d, outside=True) for x in (0.0, along))
    off = np.abs(total_length(there, 4000) - total_length(here, 4000))
    assert (off > 1e-4).mean() < 0.015


@pytest.mark.parametrize(("thickness", "most"), [(0.1, 0.002), (0.3, 0.006)])
@pytest.mark.slow
def test_few_rays_lose_a_shell_where_shells_overlap(thickness: float, most: float) -> None:
    """At vertices, posts and edges: beside the JAX engine, which looks for entries all along a ray."""
    mesh = load_mesh(Path(__file__).parents[1] / "data" / "suzanne.obj")
    shell = extrude(mesh, thickness, thickness)
    rays = aim_rays(shell, 8000, 3.0, np.random.default_rng(7))
    d = single(rays.d)
    true = Boundary(shell, mesh.faces).trace(rays.o, d)
    off = total_length(trace(Shells([shell]), rays.o, d, true.end, outside=True), 8000) - total_length(true, 8000)
    assert (off < 1e-3 * thickness).all() and (off < -1e-3 * thickness).mean() < most


def test_an_offset_that_the_numbers_hold_changes_nothing() -> None:
    """A surface and rays on a grid of 2⁻⁶, then 2¹⁷ away, where floats have that grid: 65536 times the ball's diameter."""
    grid = 2.0**-6
    near = ball(1, 1.0)
    near = replace(near, vertices=(np.round(near.vertices / grid) * grid).astype(np.float32))
    away = 2.0**17 * np.array([1, -1, 0.5])
    far = replace(near, vertices=(near.vertices.astype(np.float64) + away).astype(np.float32))
    np.testing.assert_array_equal(far.vertices - away, near.vertices)
    shells = [extrude(m, 0.3, 1.0) for m in (near, far)]
    np.testing.assert_array_equal(shells[0].offset, shells[1].offset)
    o, d = rays_at(np.random.default_rng(1).normal(size=(4000, 3)) * 0.6, 3.0, np.random.default_rng(2))
    o, d = np.round(o / grid) * grid, single(d)
    here, there = (trace(Shells([s]), x, d, outside=True) for s, x in zip(shells, (o, o + away), strict=True))
    assert (total_length(here, 4000) > 0.1).sum() > 1000
    np.testing.assert_allclose(total_length(there, 4000), total_length(here, 4000), atol=1e-6)
    meets = dr_march.hits(far, o + away, d)
    np.testing.assert_allclose(meets, dr_march.hits(near, o, d), atol=1e-5)  # so does the user's own scene


def test_canonical_frames_do_not_lose_digits_far_away() -> None:
    """J⁻¹ of a piece is that of the same shell about the origin."""
    grid, away = 2.0**-6, 2.0**17 * np.array([1, -1, 0.5])
    near = sheet(lambda x, y: np.round(0.2 * np.sin(3 * x + y) / grid) * grid)
    far = replace(near, vertices=(near.vertices.astype(np.float64) + away).astype(np.float32))
    found = []
    for mesh in (near, far):
        shells = Shells([replace(extrude(near, 0.15, 0.25), base=mesh.vertices)])
        here = canonical_frame(shells, some_piece(len(near.faces)))
        found.append([np.array(x) for x in (here.a, here.b, here.c, here.xi0, here.xi1)])
    for a, b in zip(*found, strict=True):
        np.testing.assert_array_equal(a, b)


def some_piece(prisms: int) -> Piece:
    rng = np.random.default_rng(3)
    lam, h, t = rng.dirichlet((1, 1, 1), (2, 500))[..., :2], rng.random((2, 500)), np.sort(rng.random((2, 500)), axis=0)
    first, last = (mi.Vector2d(np.ascontiguousarray(x.T)) for x in lam)
    prism = mi.UInt32(rng.integers(0, prisms, 500).astype(np.uint32))
    return Piece(prism, mi.Float64(t[0]), mi.Float64(t[1]), first, last, mi.Float64(h[0]), mi.Float64(h[1]))


# --- 4: shared vertices and edges


def leaks(radius: float, centre: tuple[float, float, float], count: int, outside: bool) -> tuple[int, int]:
    """How many rays at vertices, posts and edges have a length that is wrong by 1e-4 of the ball, of how many."""
    shell = extrude(ball(2, radius, centre), 0.2 * radius, radius)
    shells, rng = Shells([shell]), np.random.default_rng(5)
    wrong = compared = 0
    for part in range(0, count, PART):
        size = min(PART, count - part)
        o, d = (single(x) for x in rays_at(targets(shell, size, rng), 3 * radius, rng))
        enters, leaves, end, clear = spans(shell, o, d)
        found = trace(shells, o, d, end, outside)
        length = np.maximum(np.minimum(leaves, end) - enters, 0)
        some = clear > 1e-3 * radius
        wrong += (some & (np.abs(total_length(found, size) - length) > 1e-4 * radius)).sum()
        compared += some.sum()
    assert compared > 0.9 * count
    return wrong, compared


@pytest.mark.parametrize("outside", [False, True])
def test_no_leak(outside: bool) -> None:
    assert leaks(1.0, (0, 0, 0), 20000, outside)[0] == 0


def test_few_leaks_far_from_the_origin() -> None:
    wrong, compared = leaks(16.0, FAR, 20000, True)
    assert wrong <= 2e-5 * compared


@pytest.mark.slow
@pytest.mark.parametrize(("radius", "centre"), [(1.0, (0.0, 0.0, 0.0)), (16.0, FAR)])
def test_few_leaks_in_a_million_rays(radius: float, centre: tuple[float, float, float]) -> None:
    wrong, compared = leaks(radius, centre, 1_000_000, True)
    assert wrong <= 2e-5 * compared


# --- 2: grazing rays


@pytest.mark.parametrize("angle", [1e-3, 1e-5])
def test_chords_of_rays_that_graze_a_shell(angle: float) -> None:
    shell = extrude(ball(), 0.2, 1.0)
    rng = np.random.default_rng(4)
    faces = rng.integers(0, len(shell.faces), 1000)
    top = (shell.base.astype(np.float64) + shell.offset)[shell.faces]
    normal = np.cross(top[:, 1] - top[:, 0], top[:, 2] - top[:, 0])[faces]
    d = grazing(-normal, angle, rng)
    o = np.einsum("rk,rki->ri", rng.dirichlet((1, 1, 1), 1000), top[faces]) - 2 * d
    found = trace(Shells([shell]), o, d, outside=True)
    shifts = [span_of_convex(top, o + s * unit(normal), d) for s in (-SHIFT, SHIFT)]
    longest, shortest = (np.maximum(leaves - enters, 0) for enters, leaves in shifts)
    length = total_length(found, 1000)
    assert (length > 0).mean() > 0.95
    assert (length >= shortest - 1e-6).all() and (length <= longest + 1e-6).all()


# --- 5: slivers


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-6])
def test_slivers_lose_nothing(width: float) -> None:
    """A flat square that a strip of two slivers runs through: every ray's length is that of a slab."""
    x = np.array([-1, 0.1, 0.1 + width, 1])
    points = np.array([[a, b, 0] for b in (-1, 1) for a in x])
    faces = np.array([f for i in range(3) for f in ((i, i + 1, i + 5), (i, i + 5, i + 4))])
    mesh = plain(points, faces)
    assert len(mesh.faces) == 6
    shells, rng = Shells([extrude(mesh, 0.3, 1.0)]), np.random.default_rng(5)
    target = np.stack(
        [0.1 + width * rng.uniform(-1, 2, 2000), rng.uniform(-0.5, 0.5, 2000), np.full(2000, 0.15)], axis=1
    )
    d = unit(rng.normal(size=(2000, 3)) * [1, 1, 0] + [0, 0, -2])
    found = trace(shells, target - 3 * d, d)
    inside = (np.abs((target + 0.2 * d)[:, :2]) < 1).all(axis=1) & (np.abs((target - 0.2 * d)[:, :2]) < 1).all(axis=1)
    assert inside.sum() > 1000
    np.testing.assert_allclose(total_length(found, 2000)[inside], (0.3 / -d[:, 2])[inside], rtol=1e-5)


# --- 6: a shell that is thinned where it would fold


def test_a_groove_that_was_thinned_is_marched_as_it_lies() -> None:
    mesh = grown_up(lambda x, y: 2 * x * x)
    shell = extrude(mesh, 0.8, uv_stretch(mesh))
    assert any("thickness reduced" in note for note in shell.notes)
    o, d = rays_through(mesh, 12, 8)
    assert_as_sampled(trace(Shells([shell]), o, d), shell, o, d, 6.0)


# --- 7: re-entry, several visits, a camera inside


@pytest.mark.parametrize("outside", [True, False])
@pytest.mark.parametrize("scene", SCENES)
def test_intervals_are_where_the_shell_is(scene: str, outside: bool) -> None:
    mesh, thickness = SCENES[scene]
    shell = extrude(mesh, thickness, 1.0)
    o, d = rays_through(mesh, 12, 8)
    outside &= not locate(shell, o).any()
    found = trace(Shells([shell]), o, d, outside=outside)
    visits = assert_as_sampled(found, shell, o, d, 6.0)
    if scene != OVERLAPPING:
        assert_ends_on_ray(found, shell, o, d, 1e-5)
    assert visits.max() >= 2


@pytest.mark.parametrize("scene", SCENES)
def test_a_camera_inside_the_shell(scene: str) -> None:
    mesh, thickness = SCENES[scene]
    shell = extrude(mesh, thickness, 1.0)
    rng = np.random.default_rng(9)
    prism = rng.integers(0, len(shell.faces), 12)
    o = prism_point(shell, prism, rng.dirichlet((2, 2, 2), 12)[:, :2], rng.uniform(0.1, 0.9, 12))
    d = unit(rng.normal(size=(12, 3)))
    found = trace(Shells([shell]), o, d)
    assert_as_sampled(found, shell, o, d, 5.0)
    assert np.isin(np.arange(12), found.intervals.ray[found.intervals.t0 == 0]).all()


def test_a_ray_that_is_said_to_be_outside_and_is_not_meets_nothing_there() -> None:
    """As a path that goes on from where light leaves the shell: ρ holds what it would meet."""
    shell = extrude(torus(), 0.12, 1.0)
    rng = np.random.default_rng(10)
    prism = rng.integers(0, len(shell.faces), 300)
    o = prism_point(shell, prism, rng.dirichlet((2, 2, 2), 300)[:, :2], rng.uniform(0.5, 0.9, 300))
    d = unit(shell.offset[shell.faces[prism, 0]].astype(np.float64) + 0.01 * rng.normal(size=(300, 3)))
    shells = Shells([shell])
    known, asked = (total_length(trace(shells, o, d, 0.1, outside), 300) for outside in (True, False))
    assert (asked > 0.005).all() and (known == 0).all()


# --- 8: degenerate rays


@pytest.mark.parametrize("outside", [True, False])
def test_rays_that_are_none_miss_and_their_neighbours_do_not_notice(outside: bool) -> None:
    shells, rng = Shells([extrude(ball(1), 0.2, 1.0)]), np.random.default_rng(11)
    o, d = rays_at(0.5 * rng.normal(size=(20, 3)), 3.0, rng)
    bad_o, bad_d = (np.array([pair[k] for pair in BAD.values()], float) for k in (0, 1))
    alone = trace(shells, o, d, outside=outside).intervals
    mixed = trace(shells, np.concatenate([bad_o, o]), np.concatenate([bad_d, d]), outside=outside).intervals
    assert len(alone.ray) and (mixed.ray >= len(BAD)).all()
    for a, b in zip(mixed, alone._replace(ray=alone.ray + len(BAD)), strict=True):
        np.testing.assert_array_equal(a, b)


# --- 9: seams and mirrored charts


def jumps(mesh: Mesh, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """ξ at the start of a piece less ξ at the end of the one before it, where those touch; and the place's angle."""
    shell = extrude(mesh, 0.15, 0.25)
    shells, rng = Shells([shell]), np.random.default_rng(seed)
    corners = mesh.vertices[mesh.faces[rng.integers(0, len(mesh.faces), 3000)]]
    o, d = rays_at(np.einsum("rk,rki->ri", rng.dirichlet((1, 1, 1), 3000), corners), 2.0, rng)
    i = trace(shells, o, d).intervals
    begin, end = (mi.Vector2d(np.ascontiguousarray(x.T)) for x in (i.bary0, i.bary1))
    t0, t1, h0, h1 = (mi.Float64(x) for x in (i.t0, i.t1, i.h0, i.h1))
    here = canonical_frame(shells, Piece(mi.UInt32(i.prism.astype(np.uint32)), t0, t1, begin, end, h0, h1))
    first, last = np.array(here.xi0).T, np.array(here.xi1).T
    follows = (i.ray[1:] == i.ray[:-1]) & (np.abs(i.t0[1:] - i.t1[:-1]) < 1e-9)
    follows &= (shell.neighbour[i.prism[:-1]] == i.prism[1:, None]).any(axis=1)
    at = (o[i.ray] + i.t0[:, None] * d[i.ray])[1:][follows]
    assert follows.sum() > 500
    return (first[1:] - last[:-1])[follows], np.arctan2(at[:, 1], at[:, 0])


WAVY = sheet(lambda x, y: 0.2 * np.sin(3 * x + y))


@pytest.mark.parametrize("mesh", [WAVY, mirrored(WAVY)], ids=["plain", "mirrored"])
def test_continuous_where_the_chart_is(mesh: Mesh) -> None:
    assert np.abs(jumps(mesh, 12)[0]).max() < 1e-5


def test_a_seam_jumps_by_the_circumference_and_nothing_else_does() -> None:
    jump, angle = jumps(cylinder(), 13)
    patches = extrude(cylinder(), 0.15, 0.25).uv[..., 0].max()
    at_seam = np.abs(angle) < 1e-5
    assert at_seam.sum() > 10 and np.abs(jump[~at_seam]).max() < 1e-5
    np.testing.assert_allclose(np.abs(jump[at_seam]), np.tile([patches, 0, 0], (at_seam.sum(), 1)), atol=1e-5)


def test_frames_on_a_mirrored_chart_are_mirrored() -> None:
    piece = some_piece(len(WAVY.faces))
    one, other = (canonical_frame(Shells([extrude(m, 0.15, 0.25)]), piece) for m in (WAVY, mirrored(WAVY)))
    for name, sign in (("a", -1), ("b", 1), ("c", 1)):
        np.testing.assert_allclose(np.array(getattr(other, name)), sign * np.array(getattr(one, name)), atol=1e-5)
