"""The table of layers against the published generator's, and its filters against SciPy's."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import firwin

from mesoshell.signal.kaiser import lowpass, radial_lowpass
from mesoshell.signal.schedule import layer_schedule

TABLES = json.loads((Path(__file__).parent.parent / "data/aliasfree/schedule.json").read_text())


@pytest.mark.parametrize("name", TABLES)
def test_every_field_of_every_row(name: str) -> None:
    rows = layer_schedule(int(name[1:]), "T" if name[0] == "T" else "R")
    assert len(rows) == len(TABLES[name])
    for row, expected in zip(rows, TABLES[name], strict=True):
        assert vars(row).keys() == expected.keys()
        for field, value in expected.items():
            found = getattr(row, field)
            if value is None or isinstance(value, str | bool):
                assert found == value, field
            else:
                np.testing.assert_allclose(found, value, rtol=1e-5, atol=1e-8, err_msg=f"{row.name} {field}")


def test_channels_follow_base_and_max() -> None:
    rows = layer_schedule(64, "T", channel_base=4096, channel_max=48, out_channels=32)
    assert [row.out_channels for row in rows[:3]] == [48] * 3  # min(4096 / (2 · 2), 48)
    assert rows[12].out_channels == 48  # min(4096 / (2 · 32), 48)
    assert rows[-1].out_channels == 32
    assert layer_schedule(64, "T", channel_base=1024, channel_max=48)[12].out_channels == 16


@pytest.mark.parametrize("resolution", [0, 8, 48, 100])
def test_other_resolutions_are_refused(resolution: int) -> None:
    with pytest.raises(ValueError, match=f"not {resolution}"):
        layer_schedule(resolution)


@given(taps=st.integers(2, 16).map(lambda n: 2 * n), cutoff=st.floats(0.5, 7.0), width=st.floats(0.2, 6.0))
def test_separable_filter_is_scipys(taps: int, cutoff: float, width: float) -> None:
    expected = firwin(taps, cutoff, width=2 * width, fs=16.0)
    np.testing.assert_allclose(lowpass(taps, cutoff, width, 16.0), expected, rtol=0, atol=1e-13)


def test_radial_filter_is_symmetric_and_lets_the_mean_through() -> None:
    f = radial_lowpass(12, 2.0, 3.0, 16.0)
    np.testing.assert_allclose(f.sum(), 1, rtol=1e-14)
    for same in (f.T, f[::-1], f[:, ::-1]):
        np.testing.assert_allclose(f, same, rtol=0, atol=1e-17)


def test_radial_response_is_the_same_in_every_direction() -> None:
    """The gain at one frequency, along an axis and along the diagonal; a separable filter differs there by 0.2."""
    taps = 24
    x = (np.arange(taps) - (taps - 1) / 2) / 16.0

    def gain(f: np.ndarray, angle: float) -> float:
        u, v = 2.5 * np.cos(angle), 2.5 * np.sin(angle)
        return float(np.cos(2 * np.pi * v * x) @ f @ np.cos(2 * np.pi * u * x))

    radial, one = radial_lowpass(taps, 2.0, 3.0, 16.0), lowpass(taps, 2.0, 3.0, 16.0)
    assert abs(gain(radial, 0) - gain(radial, np.pi / 4)) < 0.01
    assert abs(gain(np.outer(one, one), 0) - gain(np.outer(one, one), np.pi / 4)) > 0.1
