"""What rays meet on a mesh that wears a surface material: frames, places and curvature, by brute force and by laws."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mesoshell.geometry.mesh import Mesh, check_mesh, surface_area
from mesoshell.render.quality import Quality
from mesoshell.surface_material.intersector import Local, SurfaceIntersector
from mesoshell.surface_material.tables import MIN_COSINE, surface_tables
from tests.helpers import wearing

CURVE, POINT = Quality(), Quality(curvature_filter="point")
NOTHING = np.zeros((0, 3, 3))


def intersector(mesh: Mesh, period: float, quality: Quality = CURVE) -> SurfaceIntersector:
    return SurfaceIntersector(surface_tables(mesh, period, quality), NOTHING)


def toward(mesh: Mesh, count: int, seed: int = 0, face: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
    """Rays toward places on a mesh from outside: origins, unit directions, and the faces and barycentric weights."""
    random = np.random.default_rng(seed)
    face = random.integers(len(mesh.faces), size=count) if face is None else face
    bary = random.dirichlet([2, 2, 2], count)
    corner = mesh.vertices[mesh.faces[face]].astype(np.float64)
    place = np.einsum("ik,ikj->ij", bary, corner)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    d = wearing.directions(random, count)
    d *= -np.sign(np.einsum("ij,ij->i", d, normal))[:, None]
    d = d - 0.2 * normal
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return place - 0.01 * d, d, face, bary


def local(d: SurfaceIntersector, o: np.ndarray, w: np.ndarray, cone: float = 0.01) -> Local:
    """Queries of rays that all meet something."""
    hits = d.meet(o, w)
    assert (hits.face >= 0).all()
    return d.queries(hits, np.arange(len(o)), w, np.full(len(o), cone))


def intersect(mesh: Mesh, o: np.ndarray, d: np.ndarray) -> tuple[float, int, np.ndarray]:
    """Nearest hit of one ray by solving for every face in float64: distance, face, barycentric weights."""
    found = (np.inf, -1, np.zeros(3))
    for k, face in enumerate(mesh.faces):
        a, b, c = mesh.vertices[face].astype(np.float64)
        matrix = np.stack([b - a, c - a, -d], axis=1)
        if abs(np.linalg.det(matrix)) < 1e-14:
            continue
        u, v, t = np.linalg.solve(matrix, o - a)
        if min(u, v, 1 - u - v) > 0 and 0 < t < found[0]:
            found = (t, k, np.array([1 - u - v, u, v]))
    return found


def chart_area(uv: np.ndarray) -> float:
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2)


@pytest.fixture(scope="module")
def lump() -> Mesh:
    return wearing.lump()


def test_queries_by_brute_force(lump: Mesh) -> None:
    """Each in plain float64: the hit, its place, frame, direction, footprint, and κ out of the table."""
    period = 0.3
    d, rays = intersector(lump, period), toward(lump, 60)
    o, w = rays[0] - 2.0 * rays[1], rays[1]  # from farther off, where others may come first
    hits = d.meet(o, w)
    uv = lump.uv.astype(np.float64)
    corner = lump.vertices[lump.faces].astype(np.float64)
    world = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum()
    flat = 2 * chart_area(uv)
    uv *= np.sqrt(world / flat) / period
    rows = np.flatnonzero(hits.face >= 0)
    assert len(rows) > 50
    found = d.queries(hits, rows, w[rows], np.full(len(rows), 0.05))
    checked = 0
    for k, row in enumerate(rows):
        t, face, bary = intersect(lump, o[row], w[row])
        if face != hits.face[row] or bary.min() < 1e-4:
            continue  # on an edge
        checked += 1
        a, b, c = corner[face]
        outward = np.cross(b - a, c - a)
        assert hits.front[row] == (outward @ w[row] < 0)
        np.testing.assert_allclose(hits.t[row], t, rtol=1e-5)
        place = bary @ uv[face]
        apart = (found.u[k] - place + 0.5) % 1 - 0.5
        assert np.abs(apart).max() < 1e-4 and (found.u[k] >= 0).all() and (found.u[k] < 1).all()
        n = bary @ lump.normals[lump.faces[face]].astype(np.float64)
        n /= np.linalg.norm(n)
        # ∂P/∂(u, v): P = a + E s where (u, v) = u_a + U s
        e, f = (
            np.stack([b - a, c - a], axis=1),
            np.stack([uv[face, 1] - uv[face, 0], uv[face, 2] - uv[face, 0]], axis=1),
        )
        du, dv = (e @ np.linalg.inv(f)).T
        tangent = du - (du @ n) * n
        tangent /= np.linalg.norm(tangent)
        bitangent = np.cross(n, tangent)
        bitangent *= np.sign(bitangent @ dv)
        np.testing.assert_allclose(found.axes[k], [tangent, bitangent, n], atol=2e-4)
        view = np.array([tangent @ -w[row], bitangent @ -w[row], max(n @ -w[row], MIN_COSINE)])
        np.testing.assert_allclose(found.w[k], view / np.linalg.norm(view), atol=2e-4)
        np.testing.assert_allclose(found.radius[k], 0.05 / period, rtol=1e-12)
        kappa = 0.0
        for share, vertex in zip(bary, lump.faces[face], strict=True):
            x, y = (
                axis[vertex].astype(np.float64) @ w[row] for axis in (d.tables.table.tangent, d.tables.table.bitangent)
            )
            count = d.tables.table.kappa.shape[1]
            j = (np.arctan2(y, x) / np.pi * count) % count
            values = np.append(d.tables.table.kappa[vertex], d.tables.table.kappa[vertex, 0]).astype(np.float64)
            kappa += share * np.interp(j, np.arange(count + 1), values) * period
        np.testing.assert_allclose(found.kappa[k], kappa, atol=2e-4)
    assert checked > 45
    assert np.ptp(found.kappa) > 0.2


def test_frames_are_orthonormal_and_directions_are_unit(lump: Mesh) -> None:
    o, w, *_ = toward(lump, 500)
    found = local(intersector(lump, 0.2), o, w)
    np.testing.assert_allclose(found.axes @ found.axes.transpose(0, 2, 1), np.tile(np.eye(3), (500, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found.w, axis=1), 1, atol=1e-12)
    assert (np.linalg.det(found.axes) > 0).all() and (found.w[:, 2] > 0).all()


def test_a_tube_is_curved_around_and_straight_along() -> None:
    """κ is 1/R periods around, 0 along, and between by Euler; both filters say the same, since it is the same everywhere."""
    radius, period = 2.0, 0.5
    mesh = wearing.tube(radius, 3.0, 48, 12)
    for quality in (CURVE, POINT):
        meshed = intersector(mesh, period, quality)
        for angle in np.radians([0, 20, 45, 70, 90, 135, 180, 270]):
            place = np.array([2.5, 0.01, 1.52])  # in the middle of its height: near the x axis u runs along y
            d = np.array([-0.8, 0.6 * np.cos(angle), 0.6 * np.sin(angle)])
            start = place - 0.5 * d - [0.5 - 1e-3, 0, 0]
            found = local(meshed, start[None], d[None])
            np.testing.assert_allclose(found.kappa, np.cos(angle) ** 2 * period / radius, atol=0.01)
            np.testing.assert_allclose(found.axes[0] @ [1, 0, 0], [0, 0, 1], atol=0.1)
            np.testing.assert_allclose(found.w[0], [-d[1], -d[2], 0.8], atol=0.1)


def test_a_ball_is_as_curved_everywhere_from_outside_only() -> None:
    """κ is a period over the radius along every direction; of a bowl, which is seen from within, it is minus that."""
    radius, period = 1.5, 0.4
    mesh = wearing.ball(radius, 40, 20)
    middle = np.flatnonzero(np.abs(mesh.vertices[mesh.faces].mean(axis=1)[:, 2]) < 0.8 * radius)
    o, w, *_ = toward(mesh, 200, face=np.random.default_rng(1).choice(middle, 200))
    np.testing.assert_allclose(local(intersector(mesh, period), o, w).kappa, period / radius, atol=0.02)
    part = check_mesh(mesh.vertices.astype(np.float64), mesh.faces[middle], mesh.uv[middle], "part")
    bowl = wearing.turned(part)
    inner = np.flatnonzero(np.abs(bowl.vertices[bowl.faces].mean(axis=1)[:, 2]) < 0.5 * radius)
    o, w, *_ = toward(bowl, 200, face=np.random.default_rng(1).choice(inner, 200))
    np.testing.assert_allclose(local(intersector(bowl, period), o, w).kappa, -period / radius, atol=0.03)


def test_u_counts_periods() -> None:
    """On an even chart exactly; on any, as many square periods as there is surface."""
    found = local(
        intersector(wearing.square(), 0.25),
        np.array([[0.3, 0.7, 1.0], [0.3 + 0.25, 0.7, 1.0]]),
        np.tile([0.0, 0, -1], (2, 1)),
    )
    np.testing.assert_allclose(found.u, [[0.2, 0.8]] * 2, atol=1e-6)
    mesh = wearing.ball(1.3)
    uv = surface_tables(mesh, 0.2, POINT).uv
    np.testing.assert_allclose(chart_area(uv) * 0.2**2, surface_area(mesh), rtol=1e-6)


def test_a_step_along_t_is_a_step_in_u(lump: Mesh) -> None:
    """Differences over a face: where t leads u grows, and the more the smaller the period; b does not change it by more than
    the chart is skewed."""
    o, w, face, _ = toward(lump, 200)
    for period in (0.5, 0.1):
        d = intersector(lump, period)
        found = local(d, o, w)
        h = 1e-3
        p = lump.vertices[lump.faces[face]].astype(np.float64)
        e = np.stack([p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]], axis=2)
        s = np.einsum("ikj,ij->ik", np.linalg.pinv(e), h * found.axes[:, 0])
        uv = d.tables.uv[face]
        du = s[:, :1] * (uv[:, 1] - uv[:, 0]) + s[:, 1:] * (uv[:, 2] - uv[:, 0])
        assert (du[:, 0] > 0).all()
        np.testing.assert_allclose(np.median(du[:, 0]) * period / h, 1, rtol=0.5)


def test_mirrored_charts_turn_the_frame_round(lump: Mesh) -> None:
    """With u mirrored, t and ω_x change sign, and what else is seen stays; the frame is left-handed then."""
    mirrored = replace(lump, uv=(lump.uv * np.array([-1, 1], np.float32)))
    o, w, *_ = toward(lump, 300)
    one, other = (local(intersector(mesh, 0.3), o, w) for mesh in (lump, mirrored))
    turned = np.array([-1.0, 1, 1])
    np.testing.assert_allclose(other.axes, one.axes * turned[:, None], atol=1e-9)
    np.testing.assert_allclose(other.w, one.w * turned, atol=1e-9)
    np.testing.assert_allclose(other.kappa, one.kappa, atol=1e-9)
    assert (np.linalg.det(other.axes) < 0).all()


@pytest.mark.parametrize("size", [0.0, 1e-30, 1e-15])
def test_faces_without_area_in_the_chart_have_a_frame(lump: Mesh, size: float) -> None:
    """Whatever it is, it is one: as of a face that lies along a line, or in a point, of the chart."""
    uv = lump.uv.copy()
    uv[::3] = np.float32(size) * uv[::3]
    uv[1::3, :, 1] = 0.25
    mesh = replace(lump, uv=uv)
    o, w, *_ = toward(mesh, 300)
    found = local(intersector(mesh, 0.3), o, w)
    for array in found:
        assert np.isfinite(array).all()
    np.testing.assert_allclose(found.axes @ found.axes.transpose(0, 2, 1), np.tile(np.eye(3), (300, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(found.w, axis=1), 1, atol=1e-9)


def test_moving_turning_and_scaling_change_no_query(lump: Mesh) -> None:
    """A mesh, its period, rays and cones, turned, moved far off and enlarged: the same queries, and axes that are turned."""
    turn = Rotation.from_rotvec([0.3, -0.7, 1.1]).as_matrix()
    o, w, *_ = toward(lump, 200)
    one = local(intersector(lump, 0.3), o, w, 0.02)
    for size, away, error in ((1.0, 0.0, 1e-5), (50.0, 0.0, 1e-5), (1e-3, 0.0, 1e-5), (1.0, 1e3, 3e-3)):
        points = size * lump.vertices.astype(np.float64) @ turn.T + away
        mesh = replace(
            lump,
            vertices=points.astype(np.float32),
            normals=(lump.normals.astype(np.float64) @ turn.T).astype(np.float32),
        )
        other = local(intersector(mesh, 0.3 * size), size * o @ turn.T + away, w @ turn.T, 0.02 * size)
        np.testing.assert_allclose(np.abs((other.u - one.u + 0.5) % 1 - 0.5), 0, atol=10 * error)
        np.testing.assert_allclose(other.radius, one.radius, rtol=1e-9)
        np.testing.assert_allclose(other.w, one.w, atol=10 * error)
        np.testing.assert_allclose(other.axes, one.axes @ turn.T, atol=10 * error)
        assert np.median(np.abs(other.kappa - one.kappa)) < 0.02


def test_normals_that_look_away_leave_a_ray_above_the_horizon() -> None:
    """A ray that grazes a coarse ball meets faces whose normal, interpolated, it looks at from below."""
    mesh = wearing.ball(1.0, 6, 4)
    random = np.random.default_rng(0)
    d = wearing.directions(random, 20000)
    across = np.cross(d, wearing.directions(random, 20000))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    o = 0.97 * random.random((20000, 1)) ** 0.1 * across - 3 * d
    meshed = intersector(mesh, 0.3)
    hits = meshed.meet(o, d)
    rows = np.flatnonzero((hits.face >= 0) & hits.front)
    found = meshed.queries(hits, rows, d[rows], np.zeros(len(rows)))
    below = np.einsum("ij,ij->i", found.axes[:, 2], -d[rows]) < 0
    assert below.sum() > 10
    # its length is made 1 again, and was that of what lies in the plane
    assert (found.w[below, 2] >= MIN_COSINE * (1 - 1e-6)).all() and (found.w[below, 2] < 1.5 * MIN_COSINE).all()
    np.testing.assert_allclose(np.linalg.norm(found.w, axis=1), 1, atol=1e-12)


def test_what_was_not_trained_is_counted() -> None:
    radius = 2.0
    mesh = wearing.tube(radius, 3.0, 24, 6)
    tables = surface_tables(mesh, 1.0, POINT)
    kappa = tables.table.kappa
    assert tables.notes((-1.0, 1.0)) == tables.table.notes
    for low, high in ((-1.0, 0.3), (0.2, 1.0), (0.4, 0.45)):
        (note,) = set(tables.notes((low, high))) - set(tables.table.notes)
        wrong = sum(bool((row < low - 1e-3).any() or (row > high + 1e-3).any()) for row in kappa)
        assert wrong > 0
        assert f"outside the trained {low:g} to {high:g} per period at {wrong} of {len(mesh.vertices)} vertices" in note
        assert "\n" not in note and "a smaller scale" in note
    # a smaller period is less curvature
    assert surface_tables(mesh, 0.1, POINT).notes((-0.1, 0.1)) == tables.table.notes


def test_other_objects_are_met_and_come_after() -> None:
    others = np.array([[[-5.0, -5, 0.5], [5, -5, 0.5], [0, 9, 0.5]]])
    d = SurfaceIntersector(surface_tables(wearing.square(), 0.5, POINT), others)
    o = np.array([[0.5, 0.5, 1.0], [0.5, 0.5, 0.25], [0.5, 0.5, 0.25], [9.0, 0, 1]])
    w = np.array([[0, 0, -1.0], [0, 0, 1.0], [0, 0, -1.0], [0, 0, -1]])
    hits = d.meet(o, w)
    assert hits.face[0] == hits.face[1] == 2 and hits.face[2] in (0, 1) and hits.face[3] == -1
    np.testing.assert_allclose(hits.t[:3], [0.5, 0.25, 0.25], rtol=1e-6)
    np.testing.assert_array_equal(hits.front[:3], [True, False, True])
    np.testing.assert_allclose(d.facing(hits, np.arange(2), w[:2]), [[0, 0, 1], [0, 0, -1]])
