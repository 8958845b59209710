"""Laws of a lamp's irradiance at a place: against integrals over its surface, and under motions."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mesoshell.render.lamp import Lamp, area, as_distant, facing, fault_of, radius

RGB = np.array([3.0, 2.0, 1.0])
TURN = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
KINDS = ("point", "spot", "sphere", "rectangle", "disk")


def pose(scale: Any = 1.0, at: Any = (0.0, 0.0, 0.0), turn: np.ndarray | None = None) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = (np.eye(3) if turn is None else turn) * np.broadcast_to(scale, 3)
    out[:3, 3] = at
    return out


def lamp(kind: Any, frame: np.ndarray) -> Lamp:
    return Lamp(kind, frame, RGB, (0.3, 0.9) if kind == "spot" else (0.0, 0.0))


def test_on_the_axis_of_a_disk_it_is_exact():
    """π L R² / (R² + d²)."""
    for r, d in ((0.5, 2.0), (3.0, 0.1)):
        found = as_distant(lamp("disk", pose(r, (0, 0, d))), np.zeros((1, 3)))
        np.testing.assert_allclose(found.irradiance, np.pi * RGB * r**2 / (r**2 + d**2))
        np.testing.assert_allclose(found.direction, [0, 0, 1])


@pytest.mark.parametrize("kind", ["sphere", "rectangle", "disk"])
def test_from_afar_it_is_the_integral_over_the_surface(kind: str):
    """∫ L cos θ / d² dA over points of what faces the place, on the plane that faces the middle."""
    rng = np.random.default_rng(0)
    frame, place = (
        pose((0.3, 0.2, 0.25) if kind != "sphere" else 0.3, (1.0, 2.0, 9.0), TURN),
        np.array([-1.0, 0.5, 0.0]),
    )
    one = lamp(kind, frame)
    if kind == "sphere":
        n = rng.standard_normal((200_000, 3))
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        points, whole = frame[:3, 3] + 0.3 * n, 4 * np.pi * 0.3**2
    else:
        xy = rng.uniform(-1, 1, (200_000, 2))
        xy = xy[(xy**2).sum(axis=1) < 1] if kind == "disk" else xy
        points = frame[:3, 3] + xy @ frame[:3, :2].T
        n, whole = np.broadcast_to(facing(one)[:3, 2], points.shape), area(one)
    way = points - place
    d = np.linalg.norm(way, axis=1)
    middle = (frame[:3, 3] - place) / np.linalg.norm(frame[:3, 3] - place)
    cosines = np.maximum(-(way * n).sum(axis=1) / d, 0) * (way @ middle) / d
    np.testing.assert_allclose(
        as_distant(one, place[None]).irradiance, RGB * whole * (cosines / d**2).mean(), rtol=1e-2
    )


@given(
    st.sampled_from(KINDS),
    st.floats(0.01, 100),
    st.tuples(*[st.floats(-3, 3)] * 3),
    st.tuples(*[st.floats(-9, 9)] * 3).filter(lambda at: np.linalg.norm(at) > 1),
)
def test_motions_move_it_along_and_units_cancel(kind: str, unit: float, angles: tuple, place: tuple):
    """Turned and moved with its place it lights as before; and what has an extent, in any unit."""
    turn, shift = Rotation.from_euler("xyz", angles).as_matrix(), np.array([5.0, -2.0, 1.0])
    one, at = lamp(kind, pose(0.2, (0.1, 0.0, 0.3), TURN)), np.array(place)
    moved = one._replace(
        pose=np.block([[turn @ one.pose[:3, :3], (turn @ one.pose[:3, 3] + shift)[:, None]], [0, 0, 0, 1]])
    )
    a, b = as_distant(one, at[None]), as_distant(moved, (turn @ at + shift)[None])
    if a.irradiance.any():
        np.testing.assert_allclose(b.direction, turn @ a.direction, atol=1e-9)
    np.testing.assert_allclose(b.irradiance, a.irradiance, rtol=1e-6, atol=1e-12)
    if kind not in ("point", "spot"):
        larger = one._replace(pose=np.concatenate([unit * one.pose[:3], one.pose[3:]]))
        np.testing.assert_allclose(as_distant(larger, unit * at[None]).irradiance, a.irradiance, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_at_its_own_middle_it_is_finite(kind: str):
    found = as_distant(lamp(kind, pose(0.3)), np.zeros((1, 3)))
    assert np.isfinite(found.direction).all() and np.isfinite(found.irradiance).all()
    assert np.linalg.norm(found.direction) == pytest.approx(1)


def test_over_a_lawn_it_is_the_mean_and_bounded():
    """One that hangs low over the middle does not light all as brightly as what is right below it."""
    x = np.linspace(-5, 5, 41)
    lawn = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2) @ np.eye(2, 3)
    low, high = (as_distant(lamp("point", pose(at=(0, 0, z))), lawn) for z in (0.5, 1e4))
    np.testing.assert_allclose(low.direction, [0, 0, 1], atol=1e-9)
    d = np.maximum(np.hypot(np.linalg.norm(lawn, axis=1), 0.5), 0.05 * 10 * 2**0.5)
    np.testing.assert_allclose(low.irradiance, RGB * (0.5 / d**3).mean(), rtol=1e-9)
    assert low.irradiance[0] < 0.1 * RGB[0] / 0.5**2
    np.testing.assert_allclose(high.irradiance, RGB / 1e8, rtol=1e-6)
    assert as_distant(lamp("point", pose()), lawn).irradiance[0] < RGB[0] / (0.05 * 10) ** 2


@pytest.mark.parametrize("z", [(0.0, 0.0, 0.0), (1.0, 0.0, 1.0)])
def test_sheared_and_flat_poses(z: tuple):
    """A spot shines along -z like a sun; a rectangle across its plane, and down where z has no say."""
    frame = pose()
    frame[:3, 2] = z
    np.testing.assert_allclose(facing(lamp("rectangle", frame))[:3, 2], [0, 0, -1])
    if any(z):
        np.testing.assert_allclose(facing(lamp("spot", frame))[:3, 2], -np.array(z) / 2**0.5)
    else:
        assert fault_of(lamp("spot", frame), 1e9, 1e30) == "a spot of no direction shines nowhere"


def test_a_spot_dims_between_its_angles_and_a_rectangle_shines_one_way():
    seen = lambda one, angle: as_distant(one, np.array([[2 * np.sin(angle), 0, -2 * np.cos(angle)]])).irradiance[0] * 4  # noqa: E731
    spot = lamp("spot", pose())
    np.testing.assert_allclose([seen(spot, a) for a in (0.0, 0.29, 0.6, 0.91, 3.0)], [3, 3, 1.5, 0, 0], atol=1e-9)
    for frame in (pose(), pose((1, -1, 1)), pose((-1, 1, 1)), pose((1, 1, 0.01))):  # mirrored too
        flat = lamp("rectangle", frame)
        assert seen(flat, 0.2) > 1 and seen(flat, 2.5) == 0
        assert np.linalg.det(facing(flat)[:3, :3]) > 0


def test_a_sphere_that_is_stretched_keeps_its_volume():
    assert radius(lamp("sphere", pose((0.5, 1.0, -2.0), turn=TURN))) == pytest.approx(1)


@pytest.mark.parametrize(
    ("one", "said"),
    [
        (Lamp("candle", pose(), RGB), "'candle' is no kind of lamp: point, spot, sphere, rectangle, disk"),  # type: ignore[arg-type]
        (Lamp("point", np.eye(3), RGB), "a point takes a pose of 4 × 4 numbers, none beyond 1e"),
        (Lamp("point", pose(np.nan), RGB), "a point takes a pose of 4 × 4 numbers"),
        (Lamp("point", pose(at=(1, 2, 3)).T, RGB), "a point takes a pose of 4 × 4 numbers"),
        (Lamp("disk", pose(), -RGB), "a disk takes a strength of three numbers from 0 to 1e"),
        (Lamp("disk", pose(), np.ones(2)), "a disk takes a strength of three numbers"),
        (Lamp("spot", pose(), RGB), "a spot takes a cone of two angles"),
        (Lamp("spot", pose(), RGB, (0.5, 0.4)), "a spot takes a cone of two angles"),
        (Lamp("rectangle", pose((1, 0, 1)), RGB), "a rectangle of no size shines nowhere"),
        (Lamp("sphere", pose(0.0), RGB), "a sphere of no size shines nowhere"),
    ],
    ids=lambda x: x.kind if isinstance(x, Lamp) else "",
)
def test_what_no_lamp_can_be(one: Lamp, said: str):
    assert fault_of(one, 1e9, 1e30).startswith(said)
    assert not fault_of(lamp("spot", pose()), 1e9, 1e30)
