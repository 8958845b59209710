"""Hard case 9: canonical coordinates across an edge that two prisms share: continuous where the chart is, else as cut.

The oracle is the mesh's own UVs: a sheet has one chart, a cylinder a seam where u jumps by its circumference, and a
mirrored chart turns u (and ω with it) over.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.geometry.mesh import Mesh
from mesoshell.shell.geometry.extrude import Shell, extrude
from mesoshell.shell.geometry.sampling import Chart, canonical, inverse_jacobian
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.shell.material.decoder import direction
from tests.helpers.stability.hard_rays import UP, cylinder, mirrored
from tests.helpers.stability.surfaces import rays_at, sheet

WAVY = sheet(lambda x, y: 0.2 * np.sin(3 * x + y))


def chart_of(boundary: Boundary, shell: Shell) -> Chart:
    return Chart(boundary.prisms.corners, jnp.asarray(shell.uv.reshape(-1, 6)))


def jumps(mesh: Mesh, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """ξ at the start of an interval less ξ at the end of the one before it, where those touch; and the place."""
    shell = extrude(mesh, 0.15, 0.25)
    boundary = Boundary(shell, mesh.faces)
    rng = np.random.default_rng(seed)
    o, d = rays_at(mesh.vertices[rng.integers(0, len(mesh.vertices), 3000)], 2.0, rng)
    i = boundary.trace(o, d).intervals
    xi = jax.vmap(canonical, in_axes=(None, 0, 0, 0))
    chart = chart_of(boundary, shell)
    first, last = (
        np.asarray(xi(chart, *map(jnp.asarray, (i.prism, b, h)))) for b, h in ((i.bary0, i.h0), (i.bary1, i.h1))
    )
    follows = (i.ray[1:] == i.ray[:-1]) & (np.abs(i.t0[1:] - i.t1[:-1]) < 1e-9)
    follows &= (shell.neighbour[i.prism[:-1]] == i.prism[1:, None]).any(axis=1)
    at = (o[i.ray] + i.t0[:, None] * d[i.ray])[1:][follows]
    assert follows.sum() > 500
    return (first[1:] - last[:-1])[follows], at


@pytest.mark.parametrize("mesh", [WAVY, mirrored(WAVY)], ids=["plain", "mirrored"])
def test_continuous_where_the_chart_is(mesh: Mesh):
    assert np.abs(jumps(mesh, 12)[0]).max() < 1e-5


def test_a_seam_jumps_by_the_circumference_and_nothing_else_does():
    """At a post on the seam, where six prisms meet, a ray may pass from one to another on the same side of it."""
    jump, at = jumps(cylinder(), 13)
    patches = extrude(cylinder(), 0.15, 0.25).uv[..., 0].max()
    on_seam = np.abs(np.arctan2(at[:, 1], at[:, 0])) < 1e-5
    on_post = on_seam & (np.abs(UP * at[:, 2] - np.round(UP * at[:, 2])) < 1e-5)
    across, beside = on_seam & ~on_post, ~on_seam | (on_post & (np.abs(jump[:, 0]) < 1))
    assert across.sum() > 10
    assert np.abs(jump[beside]).max() < 1e-5
    np.testing.assert_allclose(np.abs(jump[~beside]), np.tile([patches, 0, 0], ((~beside).sum(), 1)), atol=1e-5)


def test_directions_on_a_mirrored_chart_are_mirrored():
    rng = np.random.default_rng(14)
    found = []
    prism, bary = rng.integers(0, len(WAVY.faces), 200), rng.dirichlet((1, 1, 1), 200)[:, :2].astype(np.float32)
    h, d = rng.uniform(size=200).astype(np.float32), rng.normal(size=(200, 3)).astype(np.float32)
    for mesh in (WAVY, mirrored(WAVY)):
        shell = extrude(mesh, 0.15, 0.25)
        chart = chart_of(Boundary(shell, mesh.faces), shell)
        inverse = jax.vmap(inverse_jacobian, in_axes=(None, 0, 0, 0))(chart, *map(jnp.asarray, (prism, bary, h)))
        found.append(np.asarray(jax.vmap(direction)(inverse, jnp.asarray(d))))
    np.testing.assert_allclose(found[1], found[0] * np.array([-1, 1, 1]), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found[0], axis=1), 1, atol=1e-6)
