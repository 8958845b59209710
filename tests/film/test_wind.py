"""Wind combs along itself on any chart, its gusts travel with it, and it is refused where nothing can lean."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mesoshell as ms
from mesoshell.errors import InputError
from mesoshell.film.motion import Motion
from mesoshell.film.wind import SPEED, add_wind, ground_of, gusts, wind_lean
from mesoshell.geometry.mesh import check_mesh, load_mesh
from mesoshell.io.bundle import Bundle, Parameter
from mesoshell.scene.materials import Material
from tests.helpers import growing

GRID = np.array([[0.0, 0, 0], [3, 0, 0], [3, 0, -3], [0, 0, -3]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
FIELD = check_mesh(GRID, FACES, (GRID[:, [0, 2]] * [1, -1] / 3)[FACES], "field")
SUZANNE = load_mesh(Path(__file__).parents[1] / "data" / "suzanne.obj")
#: u runs along x, v along −z.
EAST, NORTH = np.array([1.0, 0, 0]), np.array([0.0, 0, -1])


def test_gusts_have_mean_zero_and_variance_one():
    at = np.random.default_rng(0).uniform(-200, 200, (200_000, 3))
    for seed in range(3):
        g = gusts(at, seed)
        assert abs(g.mean()) < 0.02 and abs(g.var() - 1) < 0.03
    assert np.corrcoef(gusts(at, 0), gusts(at, 1))[0, 1] < 0.05
    assert np.isfinite(gusts(at, -1)).all()  # a seed that renders take


def test_pixels_lie_where_they_are_painted():
    ground = ground_of(FIELD, 32)
    line = (np.arange(32) + 0.5) / 32 * 3
    u, v = np.meshgrid(line, line[::-1])
    np.testing.assert_allclose(ground.x, np.stack([u, 0 * u, -v], axis=-1), atol=1e-6)
    np.testing.assert_allclose(ground.along_u, np.broadcast_to(EAST, ground.x.shape), atol=1e-6)
    np.testing.assert_allclose(ground.along_v, np.broadcast_to(NORTH, ground.x.shape), atol=1e-6)


@pytest.mark.parametrize(("toward", "turn"), [(EAST, 0.0), (NORTH, 0.25), (-EAST, 0.5), (-NORTH, 0.75)])
def test_the_pile_leans_with_the_wind(toward: np.ndarray, turn: float):
    lean, angle = wind_lean(ground_of(FIELD), toward, 0.5, 4.0, 1.0, 0)
    mean = np.angle(np.exp(2j * np.pi * (angle - turn)).mean()) / (2 * np.pi)
    assert abs(mean) < 0.05 and 0.3 < lean.mean() < 0.7 and lean.std() > 0.05
    assert lean.dtype == angle.dtype == np.float32
    assert lean.min() >= 0 and lean.max() <= 1 and angle.min() >= 0 and angle.max() < 1


def test_what_faces_the_wind_does_not_lean():
    lean, _ = wind_lean(ground_of(FIELD), np.array([0.0, -1, 0]), 0.5, 4.0, 0.0, 0)
    assert lean.max() < 1e-6


@given(st.floats(0, 10), st.floats(-3, 3), st.integers(0, 5))
def test_gusts_travel_with_the_wind(t: float, later: float, seed: int):
    """What blows at a point is, a while later, as far downwind."""
    ground = ground_of(FIELD, 8)
    moved = replace(ground, x=ground.x + SPEED * 0.5 * 4.0 * later * EAST)
    for a, b in zip(
        wind_lean(ground, EAST, 0.5, 4.0, t, seed), wind_lean(moved, EAST, 0.5, 4.0, t + later, seed), strict=True
    ):
        away = np.abs(a - b)
        assert np.minimum(away, 1 - away).max() < 1e-4


def test_every_pixel_of_a_mesh_of_charts_has_ground():
    ground = ground_of(SUZANNE)
    low, high = SUZANNE.vertices.min(axis=0), SUZANNE.vertices.max(axis=0)
    size = np.ptp(SUZANNE.vertices)
    assert (ground.x > low - 1e-3 * size).all() and (ground.x < high + 1e-3 * size).all()
    for along in (ground.along_u, ground.along_v):
        np.testing.assert_allclose(np.linalg.norm(along, axis=-1), 1, atol=1e-6)


def scene(bundle: Bundle, names: tuple[str, ...]) -> ms.Scene:
    parameters = tuple(Parameter(name, "beta", (0.0, 1.0), 0.5, "1", name) for name in names)
    made = replace(bundle, parameters=(*bundle.parameters, *parameters), generator=growing.bundle().generator)
    return ms.Scene(FIELD, Material("pile", made), params={"dryness": 0.1})


def test_wind_changes_lean_alone(tiny_bundle: Bundle):
    begin = scene(tiny_bundle, ("lean", "lean_angle"))
    moves = add_wind(Motion(3, lambda k: {"thickness": 0.1 + k}), begin, EAST, 0.4, 12.0)
    change = moves.change(2)
    assert moves.count == 3 and set(moves.shape) == {0} and change["thickness"] == 2.1
    assert (
        set(change["params"]) == {"lean", "lean_angle"}
        and change["params"]["lean"].shape == change["params"]["lean_angle"].shape
    )
    assert not np.array_equal(moves.change(1)["params"]["lean"], change["params"]["lean"])


def test_wind_blows_over_all_that_leans(tiny_bundle: Bundle):
    """On further meshes too, by the same gusts; what has no lean is left as it is."""
    leaning, stiff = scene(tiny_bundle, ("lean", "lean_angle")), scene(tiny_bundle, ())
    away = replace(FIELD, vertices=(FIELD.vertices + np.array([1.5, 0, 0])).astype(np.float32))
    rug, moss = ms.Grown(away, leaning.material), ms.Grown(FIELD, stiff.material)
    both = replace(leaning, also=[moss, rug])
    moves = add_wind(Motion(3, lambda k: {"also": {1: {"thickness": 0.1}}}, {2}), both, EAST, 0.4, 12.0)
    change = moves.change(1)
    assert set(moves.shape) == {0, 2} and set(change["also"]) == {1} and change["also"][1]["thickness"] == 0.1
    own, other = change["params"]["lean"], change["also"][1]["params"]["lean"]
    half = own.shape[1] // 2
    np.testing.assert_allclose(own[:, half:], other[:, :half], atol=1e-5)  # where both lie, the same gust
    assert np.ptp(other[:, half:]) > 0.05
    alone = add_wind(Motion(3, lambda k: {}), replace(stiff, also=[rug]), EAST, 0.4, 12.0)
    assert set(alone.change(0)["also"]) == {0} and set(alone.shape) == {1} and "params" not in alone.change(0)
    combed = ms.Grown(FIELD, leaning.material, params={"lean": 0.2})
    assert set(add_wind(Motion(1, lambda k: {}), replace(leaning, also=[combed]), EAST, 0.4, 12.0).shape) == {0}
    baked = ms.Grown(FIELD, Material("baked", replace(leaning.material.shell, generator=None)))
    assert set(add_wind(Motion(1, lambda k: {}), replace(leaning, also=[baked]), EAST, 0.4, 12.0).shape) == {0}
    with pytest.raises(InputError, match=r"^wind: sets pile:lean, which is given too"):
        add_wind(Motion(1, lambda k: {}), replace(stiff, also=[replace(rug, params={"lean": 0.2})]), EAST, 0.4, 12.0)


def test_wind_is_refused_where_nothing_leans(tiny_bundle: Bundle):
    motion = Motion(3, lambda k: {})
    with pytest.raises(InputError, match=r"^wind: pile has no lean"):
        add_wind(motion, scene(tiny_bundle, ("lean",)), EAST, 0.4, 24.0)
    for fps in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match=r"^fps: must be positive and finite"):
            add_wind(motion, scene(tiny_bundle, ("lean", "lean_angle")), EAST, 0.4, fps)
    for name in ("lean", "lean_angle"):
        given = replace(scene(tiny_bundle, ("lean", "lean_angle")), params={name: 0.5})
        with pytest.raises(InputError, match=f"^wind: sets {name}, which is given too"):
            add_wind(motion, given, EAST, 0.4, 24.0)
        with pytest.raises(InputError, match=f"^wind: sets {name}, which is given too"):
            keyed = Motion(3, lambda k, name=name: {"params": {name: 0.1 * k}})
            add_wind(keyed, scene(tiny_bundle, ("lean", "lean_angle")), EAST, 0.4, 24.0)
    for strength in (0.0, -0.2, 1.5, np.nan):
        with pytest.raises(InputError, match=r"^wind: must be above 0"):
            add_wind(motion, scene(tiny_bundle, ("lean", "lean_angle")), EAST, strength, 24.0)


def test_a_chart_smaller_than_a_pixel_is_refused():
    flat = replace(FIELD, uv=(FIELD.uv * 1e-4).astype(np.float32))
    with pytest.raises(InputError, match=r"^wind: texture coordinates lie between the pixels"):
        ground_of(flat)
