"""Settings chosen for a goal: more time, or less error, never takes coarser ones, and what is promised can be reached."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.measure.flip import POWER
from mesoshell.render.quality import PRESETS
from mesoshell.scene import choose as room
from mesoshell.scene.accumulate import FIRST, Goal
from mesoshell.scene.choose import EXCESS, FALL, LADDER, MIN_PASSES, PROBE, SURE, Probe, Rung, choose
from mesoshell.scene.picture import Passes, Prepared, Rendered

SCENES = st.builds(Probe, st.floats(1e-3, 1e3), st.floats(1e-3, 0.5), st.floats(0.01, 100))
GOALS = st.floats(1e-2, 1e4), st.floats(1e-3, 0.5)


NOTHING = Rendered(np.zeros((4, 4, 4), np.float32), {}, {"rays": 32, "queries": 96})
PASSES = Passes(
    (4, 4), True, lambda pixels: 1, lambda k, pixels, progress: np.zeros((len(pixels), 4)), lambda x, n: NOTHING
)


def chosen(seen: Probe, budget: float | None = None, error: float | None = None) -> int:
    """The rung for a scene that looks so."""
    prepared = Prepared("jax", {}, None, (), 0.0, 0.0, lambda progress: NOTHING, lambda other: PASSES)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(room, "_probe", lambda passes: seen)
        choice = choose(prepared, PRESETS["normal"], Goal(budget, error))
    found = next(i for i, rung in enumerate(LADDER) if rung.settings is choice.settings)
    assert choice.bias == SURE * seen.noise * LADDER[found].bias
    return found


@given(st.floats(0, 1000))
def test_finer_rungs_cost_more_and_bias_less(queries: float) -> None:
    costs = [r.cost(queries) for r in LADDER]
    assert costs[0] == pytest.approx(1) and np.all(np.diff(costs) >= 0)
    assert np.all(np.diff([r.bias for r in LADDER]) <= 0)


def test_rungs_are_settings() -> None:
    for rung in LADDER:
        PRESETS["normal"].with_changes(**rung.settings)


@given(SCENES, GOALS[0], st.floats(1, 100))
def test_more_time_takes_no_coarser_settings(seen: Probe, budget: float, more: float) -> None:
    assert chosen(seen, budget) <= chosen(seen, more * budget)


@given(SCENES, GOALS[0])
def test_a_budget_holds_its_passes_if_it_can(seen: Probe, budget: float) -> None:
    found = chosen(seen, budget)
    assert MIN_PASSES * LADDER[found].cost(seen.queries) * seen.seconds <= budget * (1 + 1e-9) or found == 0


@given(SCENES, GOALS[1])
def test_an_error_is_above_the_bias_if_that_can_be(seen: Probe, error: float) -> None:
    found = chosen(seen, error=error)
    assert SURE * seen.noise * LADDER[found].bias < error or found == len(LADDER) - 1

    def seconds(rung: Rung) -> float:
        rest = error**POWER - (SURE * seen.noise * rung.bias) ** POWER
        passes = ((EXCESS * seen.noise * rung.noise) ** POWER / rest) ** (1 / FALL) if rest > 0 else np.inf
        return max(FIRST, passes) * rung.cost(seen.queries)

    if SURE * seen.noise * LADDER[found].bias < error:  # no other takes less time
        assert seconds(LADDER[found]) <= min(map(seconds, LADDER)) * (1 + 1e-6)


@given(SCENES, *GOALS)
def test_an_error_that_the_budget_does_not_allow_gives_way_to_the_budget(
    seen: Probe, budget: float, error: float
) -> None:
    of_budget, of_error = chosen(seen, budget), chosen(seen, error=error)
    assert chosen(seen, budget, error) in (of_budget, of_error)
    assert chosen(seen, 1e-6 * seen.seconds, error) == 0
    if SURE * seen.noise * LADDER[-1].bias < error:
        assert chosen(seen, 1e30, error) == of_error


@pytest.mark.parametrize("side", [64, 256])
def test_a_scene_is_probed_in_part_for_the_whole(monkeypatch, side: int) -> None:
    """Seconds of a whole pass, without compiling; and noise relative to the table's, of pixels that see it."""
    now, asked = [0.0], []
    monkeypatch.setattr(room.time, "perf_counter", lambda: now[0])
    random = np.random.default_rng(0)

    def one(k, pixels, progress):
        asked.append(len(pixels))
        now[0] += len(pixels) * 1e-4 + 20 * (k == 0)
        rgb = random.uniform(0.3, 0.7, (len(pixels), 3))
        return np.concatenate([rgb, np.ones((len(pixels), 1))], axis=1)

    passes = Passes(
        (side, side),
        True,
        lambda pixels: 1 + (pixels > PROBE * 2),
        one,
        lambda image, n: Rendered(image, {}, {"rays": 9, "queries": 27}),
    )
    seen = room._probe(passes)
    assert seen.queries == 3 and seen.seconds == pytest.approx(
        1e-4 * side**2 / (1 + (side**2 > 2 * PROBE))
    )  # a whole pass of the larger is on two threads
    assert asked[0] == asked[1] and asked[0] <= 1.5 * PROBE
    assert (asked[0] == side**2) == (side**2 <= PROBE)
    assert 0.1 < seen.noise < 1


def test_all_is_compiled_before_the_budget_begins() -> None:
    """What the scene is probed with need not be."""
    calls: list[str] = []
    passes = PASSES._replace(
        compile=lambda: calls.append("compiled"), render=lambda k, pixels, progress: _seen(calls, pixels)
    )
    prepared = Prepared("jax", {}, None, (), 0.0, 0.0, lambda progress: NOTHING, lambda other: passes)
    choose(prepared, PRESETS["normal"], Goal(1.0))
    assert calls == ["rendered", "rendered", "compiled", "rendered"]


def _seen(calls: list[str], pixels: np.ndarray) -> np.ndarray:
    calls.append("rendered")
    return np.zeros((len(pixels), 4))
