"""Hard case 6: a prism folded by its thickness is found by the Jacobian's sign; the thickness is reduced, and said.

The oracle evaluates det ∂P/∂(λ₁, λ₂, h) in float64 at random points, column by column, on the shell's float32 arrays.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.geometry.mesh import uv_stretch
from mesoshell.shell.geometry.extrude import extrude
from tests.helpers.stability.hard_rays import SIDE, surface


def least_jacobian(base: np.ndarray, offset: np.ndarray, faces: np.ndarray, points: int = 1000) -> np.ndarray:
    """The least determinant of each prism over random points of it, corners among them."""
    rng = np.random.default_rng(1)
    weights, h = rng.dirichlet((0.5, 0.5, 0.5), points), rng.beta(0.5, 0.5, points)
    weights[:6], h[:6] = np.repeat(np.eye(3), 2, axis=0), np.tile([0.0, 1.0], 3)
    b, o = base[faces].astype(np.float64), offset[faces].astype(np.float64)
    least = np.full(len(faces), np.inf)
    for w, height in zip(weights, h, strict=True):
        corner = b + height * o
        columns = np.stack([corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], w @ o], axis=-1)
        least = np.minimum(least, np.linalg.det(columns))
    return least


def test_a_groove_is_thinned_where_it_would_fold_and_nowhere_else():
    mesh = surface(lambda x, y: 2 * x * x)  # radius of curvature at x = 0: 1/4
    thickness = 0.8
    unreduced = least_jacobian(mesh.vertices, np.float32(thickness) * mesh.normals, mesh.faces)
    assert 0.1 < (unreduced < 0).mean() < 0.9
    shell = extrude(mesh, thickness, uv_stretch(mesh))
    assert (least_jacobian(shell.base, shell.offset, shell.faces) > 0).all()
    grown = np.linalg.norm(shell.offset.astype(np.float64), axis=1) / thickness
    reduced = grown < 1 - 1e-6
    assert reduced[np.unique(mesh.faces[unreduced < 0])].all()
    assert not reduced[np.abs(mesh.vertices[:, 0]) == 1].any()
    assert (grown[reduced] * thickness > 0.1).all()
    least = f"least factor {grown.min():.2g}"
    assert shell.notes == (
        f"thickness reduced at {reduced.sum()} of 81 vertices, where the shell would fold ({least})",
    )


def test_a_ridge_never_folds_however_thick():
    mesh = surface(lambda x, y: -2 * x * x)
    shell = extrude(mesh, 100.0, uv_stretch(mesh))
    assert (least_jacobian(shell.base, shell.offset, shell.faces) > 0).all()
    assert shell.notes == ()


def test_below_the_curvature_radius_nothing_is_reduced():
    mesh = surface(lambda x, y: 2 * x * x)
    shell = extrude(mesh, 0.1, uv_stretch(mesh))
    assert shell.notes == ()
    np.testing.assert_allclose(np.linalg.norm(shell.offset.astype(np.float64), axis=1), 0.1, rtol=1e-6)


def cone(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.hypot(x, y)


@pytest.mark.parametrize("thickness", [1e-3, 0.1, 10.0, 1e6])
def test_a_cone_is_never_folded(thickness: float):
    mesh = surface(lambda x, y: 4 * cone(x, y))
    shell = extrude(mesh, thickness, uv_stretch(mesh))
    assert len(shell.faces) == len(mesh.faces)
    assert (least_jacobian(shell.base, shell.offset, shell.faces) > 0).all()


@settings(deadline=None)
@given(
    st.tuples(*[st.floats(-4, 4)] * 4),
    st.floats(0, 1),
    st.floats(-3, 3).map(lambda e: 10.0**e),
    st.sampled_from([1e-20, 1e-3, 1.0, 1e4]),
    st.integers(0, 2**32 - 1),
)
def test_random_saddles_and_cones_are_never_folded(bend, rough: float, thickness: float, size: float, seed: int):
    noise = np.random.default_rng(seed).normal(size=(SIDE, SIDE)) * rough * size / SIDE
    xx, xy, yy, tip = bend
    mesh = surface(lambda x, y: (xx * x * x + xy * x * y + yy * y * y) / size + tip * cone(x, y) + noise, size)
    varied = thickness * size * np.random.default_rng(seed).uniform(0.1, 1, len(mesh.vertices))
    shell = extrude(mesh, varied, size)
    left_out = len(mesh.faces) - len(shell.faces)
    assert (left_out > 0) == any("left out" in note for note in shell.notes)
    assert left_out <= 6
    assert (least_jacobian(shell.base, shell.offset, shell.faces, 100) > 0).all()
    grown = np.linalg.norm(shell.offset.astype(np.float64), axis=1)
    assert (grown > 0).all() and (grown <= varied * (1 + 1e-6)).all()
    reduced = (grown < varied * (1 - 1e-6)).any()
    assert reduced == any("thickness reduced" in note for note in shell.notes)
