"""How different a material looks from its teacher: not at all if it answers the same, and more the more it errs."""

from typing import Any

import numpy as np
import pytest

from mesoshell.datasets.queries.render import FINEST
from mesoshell.datasets.queries.tile import PatchPlacement
from mesoshell.distill import error
from mesoshell.distill.error import LIGHTS, SIDE, errors_by_radius, radii
from mesoshell.io.query_dataset import COLUMNS

C = {name: i for i, name in enumerate(COLUMNS)}
CURVATURE, WIDEST = (-1.0, 1.5), 0.5
#: The narrowest radius where three octaves say as much as all nine.
COARSE = WIDEST / 4


@pytest.fixture(autouse=True)
def _few_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(error, "PICTURES", 5)


def told(u: np.ndarray, toward: np.ndarray, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """α and ρ by place on the texture and directions in its frame; the radius fades what varies."""
    alpha = 0.6 + 0.3 * toward[:, 2]
    rho = 0.1 * (1.2 + np.sin(2 * np.pi * u)) @ np.array([[1, 0.5, 0.2], [0, 0.5, 0.8]]) * (1 + light[:, :1])
    return alpha, rho


def teacher(
    placing: PatchPlacement, asked: dict[str, np.ndarray], seed: int
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    c, s = np.cos(placing.turn), np.sin(placing.turn)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    alpha, rho = told(placing.texture(asked["place"]), asked["toward"] @ turn.T, asked["light"] @ turn.T)
    return {"alpha": alpha[:, None], "cosine": 0 * alpha[:, None], "reflectance": alpha[:, None] * rho}, {}


def painter(scale: float, opacity: float = 1.0):
    seen: list[np.ndarray] = []

    def answers(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        seen.append(rows)
        alpha, rho = told(rows[:, [C["u"], C["v"]]], rows[:, C["wx"] : C["wz"] + 1], rows[:, C["lx"] : C["lz"] + 1])
        return opacity * alpha, 0 * alpha, scale / opacity * rho

    return answers, seen


def test_the_same_is_no_different() -> None:
    """And every octave is asked for, with directions, curvature and lights of its own."""
    answers, seen = painter(1.0)
    found = errors_by_radius(teacher, answers, CURVATURE, FINEST, WIDEST)
    octaves = [r for r, _ in found]
    assert octaves == list(radii(FINEST, WIDEST)) and (octaves[0], octaves[-1], len(octaves)) == (FINEST, WIDEST, 9)
    assert max(e for _, e in found) < 1e-3
    assert len(seen) == error.PICTURES * len(octaves) * len(LIGHTS) and all(len(rows) == SIDE**2 for rows in seen)
    kappa = np.array([rows[0, C["kappa"]] for rows in seen])
    assert (
        (kappa >= -1).all()
        and (kappa <= 1.5).all()
        and len(np.unique(kappa)) * len(LIGHTS) == len(kappa)
        and np.ptp(kappa) > 2
    )
    assert all((rows[:, C["lz"]] >= 0).all() and (rows[:, C["wz"]] > 0).all() for rows in seen)


@pytest.mark.parametrize("off", [{"scale": 0.95}, {"scale": 1.05}, {"scale": 1.0, "opacity": 0.9}])
def test_what_is_wrong_is_seen(off: dict[str, Any]) -> None:
    errors = [e for _, e in errors_by_radius(teacher, painter(**off)[0], CURVATURE, COARSE, WIDEST)]
    assert 0.005 < min(errors) < max(errors) < 0.3


def test_what_is_hardly_there_is_hardly_seen() -> None:
    """A camera exposes for what is opaque, not for what a fiftieth of it lets through."""

    def thin(placing: PatchPlacement, asked: dict[str, np.ndarray], seed: int):
        found, seconds = teacher(placing, asked, seed)
        return {name: x / 50 for name, x in found.items()}, seconds

    def twice(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        alpha, cosine, rho = painter(1.0)[0](rows)
        return alpha / 50, cosine, 2 * rho

    assert max(e for _, e in errors_by_radius(thin, twice, CURVATURE, COARSE, WIDEST)) < 0.1


def test_more_wrong_looks_more_different() -> None:
    rising = [
        np.mean([e for _, e in errors_by_radius(teacher, painter(s)[0], CURVATURE, COARSE, WIDEST)])
        for s in (0.98, 0.9, 0.7)
    ]
    assert rising[0] < 0.5 * rising[1] < 0.5 * rising[2]


def test_a_teacher_that_is_grainy_is_asked_several_times(monkeypatch) -> None:
    """Its mean is the same, and what is left of the grain is less than of one ray."""

    def grainy(placing: PatchPlacement, asked: dict[str, np.ndarray], seed: int):
        found, spent = teacher(placing, asked, seed)
        grain = np.random.default_rng(seed).choice([0.8, 1.2], size=(len(asked["radius"]), 1))
        return found | {"reflectance": grain * found["reflectance"]}, spent

    def worst() -> float:
        return max(e for _, e in errors_by_radius(grainy, painter(1.0)[0], CURVATURE, COARSE, WIDEST))

    several = worst()
    monkeypatch.setattr(error, "RAYS", 1)
    once = worst()
    assert 1e-3 < several < 0.6 * once
