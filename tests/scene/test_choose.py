"""Settings chosen for a goal: more time, or less error, never takes coarser ones, and what is promised can be reached."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.render.quality import PRESETS
from mesoshell.scene import choose as room
from mesoshell.scene.accumulate import Goal
from mesoshell.scene.choose import FEWEST, LADDER, NOISE, PROBE, choose
from mesoshell.scene.picture import Passes, Prepared, Rendered

TIMES, SCALES = st.floats(1e-3, 1e3), st.floats(0.05, 5)
GOALS = st.floats(1e-2, 1e4), st.floats(1e-3, 0.5)


NOTHING = Rendered(np.zeros((4, 4, 4), np.float32), {}, {})
PASSES = Passes(
    (4, 4), True, lambda pixels: 1, lambda k, pixels, progress: np.zeros((len(pixels), 4)), lambda x, n: NOTHING
)


def chosen(t: float, s: float, budget: float | None = None, error: float | None = None) -> int:
    """The rung for a scene of these seconds a pass and this scale."""
    prepared = Prepared("jax", {}, None, (), 0.0, 0.0, lambda progress: NOTHING, lambda other: PASSES)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(room, "_probe", lambda passes: (t, s))
        choice = choose(prepared, PRESETS["normal"], Goal(budget, error))
    found = next(i for i, rung in enumerate(LADDER) if rung.settings is choice.settings)
    assert choice.bias == s * LADDER[found].bias
    return found


def test_finer_rungs_cost_more_and_bias_less() -> None:
    assert np.all(np.diff([r.cost for r in LADDER]) > 0) and np.all(np.diff([r.bias for r in LADDER]) < 0)
    assert LADDER[0].cost == 1
    for rung in LADDER:
        PRESETS["normal"].with_changes(**rung.settings)


@given(TIMES, SCALES, GOALS[0], st.floats(1, 100))
def test_more_time_takes_no_coarser_settings(t: float, s: float, budget: float, more: float) -> None:
    assert chosen(t, s, budget) <= chosen(t, s, more * budget)


@given(TIMES, SCALES, GOALS[0])
def test_a_budget_holds_its_passes_if_it_can(t: float, s: float, budget: float) -> None:
    cost = LADDER[chosen(t, s, budget)].cost
    assert FEWEST * cost * t <= budget * (1 + 1e-9) or cost == 1


@given(TIMES, SCALES, GOALS[1])
def test_an_error_is_above_the_bias_if_that_can_be(t: float, s: float, error: float) -> None:
    found = chosen(t, s, error=error)
    assert s * LADDER[found].bias < error or found == len(LADDER) - 1
    bias = [s * rung.bias for rung in (LADDER[found], *LADDER)]
    seconds = [max(4, (s * NOISE) ** 2 / (error**2 - b**2)) if b < error else np.inf for b in bias]
    costs = [rung.cost for rung in (LADDER[found], *LADDER)]
    if bias[0] < error:  # no other takes less time
        assert seconds[0] * costs[0] <= min(a * c for a, c in zip(seconds, costs, strict=True)) * (1 + 1e-9)


@given(TIMES, SCALES, *GOALS)
def test_an_error_that_the_budget_does_not_allow_gives_way_to_the_budget(
    t: float, s: float, budget: float, error: float
) -> None:
    of_budget, of_error = chosen(t, s, budget), chosen(t, s, error=error)
    assert chosen(t, s, budget, error) in (of_budget, of_error)
    assert chosen(t, s, 1e-6 * t, error) == 0
    if s * LADDER[-1].bias < error:
        assert chosen(t, s, 1e30, error) == of_error


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
        (side, side), True, lambda pixels: 1 + (pixels > PROBE * 2), one, lambda image, samples: Rendered(image, {}, {})
    )
    t, s = room._probe(passes)
    assert t == pytest.approx(
        1e-4 * side**2 / (1 + (side**2 > 2 * PROBE))
    )  # a whole pass of the larger is on two threads
    assert asked[0] == asked[1] and asked[0] <= 1.5 * PROBE
    assert (asked[0] == side**2) == (side**2 <= PROBE)
    assert 1 < s < 20
