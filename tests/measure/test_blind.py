"""Blind tests: shuffles that keep both sets, marks as they are written, probabilities by hand."""

from math import comb

import numpy as np
import pytest

from mesoshell.measure.blind import letters, marks, score_judge, shuffle_pictures


def test_a_shuffle_knows_which_are_real() -> None:
    pose = np.arange(5, dtype=np.float32)[:, None, None, None]
    real, made = np.broadcast_to(pose, (5, 2, 2, 3)), np.broadcast_to(pose - 9, (5, 2, 2, 3))
    sheet = shuffle_pictures(real, made, 3)
    x = sheet.pictures[:, 0, 0, 0]
    np.testing.assert_array_equal(x >= 0, sheet.answer)
    np.testing.assert_array_equal(np.where(sheet.answer, x, x + 9), sheet.pose)
    assert sheet.answer.sum() == 5 and (sheet.answer != shuffle_pictures(real, made, 4).answer).any()


def test_marks_are_letters_in_rows() -> None:
    np.testing.assert_array_equal(marks("r m\nM,R\n"), [True, False, False, True])
    with pytest.raises(ValueError, match="'x'"):
        marks("rmx")


def test_guessing_and_knowing() -> None:
    answer = np.arange(10) % 2 == 0
    said = answer.copy()
    said[:2] = ~said[:2]
    found = score_judge(answer, said)
    assert (found.right, found.count, found.share) == (8, 10, 0.8)
    assert found.chance == pytest.approx(sum(comb(10, k) for k in (8, 9, 10)) / 2**10)
    assert found.low == pytest.approx(0.4439, abs=1e-4) and found.high == pytest.approx(0.9748, abs=1e-4)
    assert score_judge(answer, ~answer).chance == 1


def test_a_judge_who_is_always_right_writes_the_answer() -> None:
    answer = np.array([True, False, False, True])
    assert letters(answer) == "rmmr" and (marks(letters(answer)) == answer).all()
