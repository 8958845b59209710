"""Scores: a set of pictures beside renders, and renders beside others, measured alike."""

from dataclasses import replace

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset, read_dataset
from mesoshell.io.image import write_exr
from mesoshell.measure.features import Extractor
from mesoshell.measure.scores import halves, judge_of, renders, score, shares
from tests.helpers import fog


def colours(image: np.ndarray) -> np.ndarray:
    """Mean colour and its spread."""
    return np.concatenate([image[..., :3].mean(axis=(1, 2)), image[..., :3].std(axis=(1, 2))], axis=1)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Dataset:
    """40 pictures of noise, four of each of ten patches, as bright as they are old."""
    folder = tmp_path_factory.mktemp("scores") / "fog"
    found = fog.write(folder, [(0.6, 0.3, 1.6 + 0.02 * k) for k in range(40)], size=12)
    rng = np.random.default_rng(0)
    for sample in found.samples:
        image = np.ones((12, 12, 4), np.float32)
        image[..., :3] = (0.1 + sample.parameters["age"] / 10) * rng.uniform(0.9, 1.1, (12, 12, 1))
        write_exr(sample.file, image)
    return replace(read_dataset(folder), rows={k: {"instance": k // 4} for k in range(40)})


def test_halves_share_no_patch(data) -> None:
    a, b = halves(data, 100)
    assert len(a) == len(b) == 20
    assert not {s.index // 4 for s in a} & {s.index // 4 for s in b}
    alone = replace(data, rows={k: {"instance": 0} for k in range(40)})
    a, b = halves(alone, 6)
    assert len(a) == len(b) == 6 and not {s.index for s in a} & {s.index for s in b}
    with pytest.raises(InputError, match="too few"):
        halves(replace(data, samples=data.samples[:4]), 6)


def test_what_is_wrong_scores_worse_than_other_renders(data) -> None:
    a, b = halves(data, 100)
    judge = judge_of(data, a, [Extractor("Colour", colours)])
    real = renders(data, b)
    floor = score(judge, b, real)
    assert list(floor) == ["KID-Colour", "SWD-12", "read age"]
    assert all(e.low <= e.value <= e.high for e in floor.values())
    assert floor["read age"].value < 0.05
    other = real * np.array([2, 1, 1, 1], np.float32)
    for name, estimate in score(judge, b, other).items():
        assert estimate.value > floor[name].high, name
    wrong_age = real[np.random.default_rng(1).permutation(len(real))]
    mixed = score(judge, b, wrong_age)
    assert mixed["read age"].value > 5 * floor["read age"].value
    assert mixed["KID-Colour"].value == pytest.approx(floor["KID-Colour"].value, abs=1e-9)


def test_shares_tell_gaps_that_radiance_over_black_does_not(data) -> None:
    real = renders(data, list(data.samples[:8]))
    real[0] /= 4  # shares are of sums, to which a dark picture adds little
    assert {k: tuple(e) for k, e in shares(real, real).items()} == {k: (1.0, 1.0, 1.0) for k in ("opacity", "light")}
    gaps = real * np.array([1, 1, 1, 0.75], np.float32)
    gaps[:2, ..., 3] *= 0.4
    found = shares(real, gaps)
    wanted = 0.75 * (6 + 0.4 * 1.25) / 7.25
    assert found["light"].value == 1 and found["opacity"].value == pytest.approx(wanted, rel=1e-6)
    assert 0.5 < found["opacity"].low < found["opacity"].value - 0.01
    assert all(np.isfinite(e).all() for e in shares(0 * real, 0 * real).values())
    assert shares(real, 2 * real)["light"].value == pytest.approx(2, rel=1e-6)
