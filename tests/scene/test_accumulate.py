"""Pictures pass by pass: their mean is that of the passes, each goal ends them, and what is estimated is what the error is."""

import os
import signal
from collections.abc import Callable

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.measure.flip import flip_map
from mesoshell.scene import accumulate as room
from mesoshell.scene.accumulate import BLOCK, FIRST, Goal, Sums, accumulate, goal_of, over_backdrop
from mesoshell.scene.picture import Passes, Rendered

SHAPE = 64, 48
PIXELS = SHAPE[0] * SHAPE[1]


def truth() -> np.ndarray:
    """A smooth picture, transparent at its left."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 20
    rgb = 0.4 + 0.2 * np.stack([np.sin(x), np.cos(y), np.sin(x + y)], axis=-1)
    return np.concatenate([rgb, np.ones((*SHAPE, 1))], axis=-1) * (x > 0.5)[..., None]


def noise(k: int) -> np.ndarray:
    """Of pass k, uniform in [-1, 1], (P, 4)."""
    return np.random.default_rng(k).uniform(-1, 1, (PIXELS, 4))


class Stand:
    """Passes of the truth with noise. noisy: amplitude by pixel; chosen: as of Passes; during: called in every pass."""

    def __init__(self, noisy, chosen=True, during: Callable[[int], None] = lambda k: None):
        self.noisy, self.asked, self.during = np.broadcast_to(noisy, SHAPE).reshape(-1, 1), [], during
        self.passes = Passes(SHAPE, chosen, lambda pixels: 1, self.one, self.ended)

    def one(self, k, pixels, progress):
        self.asked.append(pixels)
        self.during(k)
        progress(0.5)
        return (truth().reshape(-1, 4) + self.noisy * noise(k))[pixels]

    def ended(self, image, samples):
        return Rendered(image, {"wall": 1.0}, {"rays": 0, "samples": samples})


def error(image: np.ndarray) -> float:
    return float(flip_map(over_backdrop(image), over_backdrop(truth())).mean())


def run(stand: Stand, progress: Callable[[float], None] = lambda share: None, **goal) -> tuple[Rendered, dict]:
    made = accumulate(stand.passes, Goal(**goal), progress)
    return made, made.record["goal"]


def test_the_most_samples_end_it_with_the_mean_of_all_passes() -> None:
    shares: list[float] = []
    made, goal = run(Stand(0.3), shares.append, max_samples=6)
    wanted = truth() + 0.3 * np.mean([noise(k) for k in range(6)], axis=0).reshape(*SHAPE, 4)
    np.testing.assert_allclose(made.rgba, wanted, atol=1e-6)
    assert goal["met"] == "max_samples" and goal["samples"] == dict.fromkeys(("least", "mean", "most"), 6)
    assert made.record["samples"] == 6 and made.record["rays"] == 0
    assert shares == sorted(shares) and shares[0] > 0 and shares[-1] <= 1


@pytest.mark.parametrize("wanted", [0.05, 0.025])
def test_an_error_is_reached_and_its_estimate_is_true(wanted: float) -> None:
    """Independent passes: the estimate is that of the error itself."""
    made, goal = run(Stand(0.3), error=wanted)
    assert goal["met"] == "error" and goal["noise"] <= wanted
    assert error(made.rgba) == pytest.approx(goal["noise"], rel=0.15)
    assert goal["samples"]["mean"] > FIRST
    assert error(made.rgba) > wanted / 2  # and no more was rendered than that takes


@pytest.mark.parametrize("counts", [(2,), (3,), (8,), (9,), (23,), (4, 11)])
def test_the_estimate_is_true_after_any_passes(counts: tuple[int, ...]) -> None:
    """Also where some pixels have more than others."""
    sums, pixels = Sums(SHAPE), np.arange(PIXELS)
    parts = np.array_split(pixels, len(counts))
    for k in range(max(counts)):
        some = np.concatenate([part for part, n in zip(parts, counts, strict=True) if k < n])
        sums.add(some, (truth().reshape(-1, 4) + 0.3 * noise(k))[some])
    np.testing.assert_array_equal(sums.passes, np.repeat(counts, [len(part) for part in parts]))
    true = flip_map(over_backdrop(sums.mean()), over_backdrop(truth())).ravel()
    for part in parts:
        assert sums.error().ravel()[part].mean() == pytest.approx(true[part].mean(), rel=0.15)


def test_a_black_picture_is_done_at_the_first_estimate() -> None:
    stand = Stand(0.0)
    black = Passes(SHAPE, True, lambda pixels: 1, lambda k, pixels, progress: np.zeros((len(pixels), 4)), stand.ended)
    goal = accumulate(black, Goal(error=1e-6), lambda share: None).record["goal"]
    assert goal["met"] == "error" and goal["noise"] == 0 and goal["samples"]["most"] == FIRST


def test_more_samples_are_taken_for_less_error() -> None:
    few, many = (run(Stand(0.3), error=e)[1]["samples"]["mean"] for e in (0.06, 0.03))
    assert many > 2 * few


def test_blocks_that_have_converged_are_left_alone_but_for_their_neighbours() -> None:
    noisy = np.zeros(SHAPE)
    noisy[:BLOCK, :BLOCK] = 0.5
    stand = Stand(noisy)
    _, goal = run(stand, error=0.004)
    first, last = np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)
    first.flat[stand.asked[0]] = last.flat[stand.asked[-1]] = True
    assert first.all() and goal["samples"]["least"] == FIRST < goal["samples"]["most"]
    assert last[: 2 * BLOCK, : 2 * BLOCK].all() and not last[-BLOCK:].any()
    others = Stand(noisy, chosen=False)
    _, goal = run(others, error=0.004)
    assert all(len(p) == PIXELS for p in others.asked) and goal["met"] == "error"


@pytest.fixture
def clock(monkeypatch) -> list[float]:
    """A clock that only the tests move."""
    now = [0.0]
    monkeypatch.setattr(room.time, "perf_counter", lambda: now[0])
    return now


@pytest.mark.parametrize("chosen", [True, False])
@pytest.mark.parametrize("budget", [2.5, 10.0, 10.6])
def test_a_budget_is_spent_and_compiling_is_not_of_it(clock: list[float], chosen: bool, budget: float) -> None:
    stand = Stand(0.1, chosen=chosen)

    def during(k: int) -> None:
        clock[0] += 0.3 + 0.7 * len(stand.asked[-1]) / PIXELS  # a second, and next to no pixels still take 0.3
        clock[0] += 30 * (k == 0)  # of compiling

    stand.during = during
    made, goal = run(stand, budget=budget)
    assert goal["met"] == "budget" and made.seconds["warming"] == pytest.approx(30)
    assert goal["seconds"] == pytest.approx(budget, abs=0.1 if chosen else 0.5)
    assert 0.3 * len(stand.asked) + 0.7 * goal["samples"]["mean"] == pytest.approx(goal["seconds"])


def test_a_pass_may_be_the_only_one_if_all_is_compiled(clock: list[float]) -> None:
    def during(k: int) -> None:
        clock[0] += 5

    stand = Stand(0.1, during=during)
    made = accumulate(stand.passes, Goal(budget=5.2), lambda share: None, warm=True)
    assert made.record["goal"]["seconds"] == 5 and len(stand.asked) == 1
    assert made.record["goal"]["noise"] is None and made.seconds["warming"] == 0


def test_a_pass_longer_than_the_budget_is_rendered_twice_at_most(clock: list[float]) -> None:
    def during(k: int) -> None:
        clock[0] += 5

    stand = Stand(0.1, during=during)
    _, goal = run(stand, budget=2.0)
    assert goal["met"] == "budget" and goal["seconds"] == 10 and len(stand.asked) == 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_the_passes_so_far(number: int) -> None:
    stand = Stand(0.3, during=lambda k: os.kill(os.getpid(), number) if k == 3 else None)
    made, goal = run(stand)
    assert goal["met"] == "interrupt" and goal["samples"]["mean"] == 3
    np.testing.assert_allclose(
        made.rgba, truth() + 0.3 * np.mean([noise(k) for k in range(3)], axis=0).reshape(*SHAPE, 4), atol=1e-6
    )
    with pytest.raises(KeyboardInterrupt):
        run(Stand(0.3, during=lambda k: os.kill(os.getpid(), number)))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((0.0, None, None, {}), "budget: must be above 0 and finite, not 0.0"),
        ((float("inf"), None, None, {}), "budget: must be above 0 and finite, not inf"),
        ((None, float("nan"), None, {}), "error: must be above 0 and below 1, not nan"),
        ((None, 1.0, None, {}), "error: must be above 0 and below 1, not 1.0"),
        ((None, None, 0, {}), "max_samples: must be at least 1, not 0"),
        (
            (2.0, None, None, {"spp": 3}),
            "spp: cannot be combined with a goal, which sets it: give `max_samples`",
        ),
    ],
)
def test_goals_that_none_can_be_are_refused(given: tuple, said: str) -> None:
    with pytest.raises(InputError, match=f"^{said}$"):
        goal_of(*given)
    assert goal_of(None, None, None, {"spp": 3}) is None
