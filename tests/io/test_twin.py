"""A distilled surface material within a shell's bundle: what comes back is what was written, and faults are one line."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mesoshell.io.bundle import Bundle, read_bundle, write_bundle
from mesoshell.io.surface import fields_of
from mesoshell.io.twin import Twin, checked_twin
from tests.helpers import wearing


def with_twin(bundle: Bundle, **more: Any) -> Bundle:
    given: dict[str, Any] = {"alpha": (0.25,), "base": (0.1, 0.2, 0.3), "errors": ((0.002, 0.3), (0.1, 0.04))}
    return replace(bundle, twin=Twin(wearing.bundle(depth=0.5), **(given | more)))


def test_it_comes_back(bundle: Bundle, tmp_path: Path) -> None:
    made = with_twin(bundle)
    assert made.twin is not None
    write_bundle(tmp_path / "a.npz", made)
    found = read_bundle(tmp_path / "a.npz")
    assert found.twin is not None and found.arrays.keys() == bundle.arrays.keys()
    assert (found.twin.alpha, found.twin.base, found.twin.errors) == (made.twin.alpha, made.twin.base, made.twin.errors)
    one, two = vars(found.twin.surface), vars(made.twin.surface)
    assert {k: v for k, v in one.items() if k != "arrays"} == {k: v for k, v in two.items() if k != "arrays"}
    assert one["arrays"].keys() == two["arrays"].keys()
    for key, array in two["arrays"].items():
        np.testing.assert_array_equal(one["arrays"][key], array)


@pytest.mark.parametrize(
    ("more", "fault"),
    [
        ({"alpha": [-1.0]}, "alpha is [-1.0]"),
        ({"alpha": 0.5}, "alpha is 0.5"),
        ({"base": [0.1, 0.2]}, "base is [0.1, 0.2]"),
        ({"base": [0.1, 0.2, True]}, "base is [0.1, 0.2, True]"),
        ({"errors": []}, "errors is []"),
        ({"errors": [[0.1, 0.2, 0.3]]}, "errors is [[0.1, 0.2, 0.3]]"),
        ({"errors": [[0.2, 0.1], [0.1, 0.1]]}, "radii of its errors must increase"),
        ({"surface": {}}, "its fields are not "),
        ({"surface": 1}, "surface is not an object"),
    ],
)
def test_faults_of_its_fields(tmp_path: Path, fault_of: Callable, more: dict, fault: str) -> None:
    right = {"surface": fields_of(wearing.bundle()), "alpha": [0.2], "base": [0.1, 0.2, 0.3], "errors": [[0.1, 0.2]]}
    assert checked_twin(tmp_path, "m", right)["alpha"] == (0.2,)
    assert fault_of(checked_twin, tmp_path, "m", right | more).startswith(f"m: twin: {fault}")
    less = {key: value for key, value in right.items() if key != "alpha"}
    assert fault_of(checked_twin, tmp_path, "m", less) == "m: twin must have the fields surface, alpha, base and errors"


def test_it_has_a_number_for_each_parameter(bundle: Bundle, tmp_path: Path, fault_of: Callable) -> None:
    """Of appearance: this bundle has one, and one of geometry."""
    fault = fault_of(write_bundle, tmp_path / "a.npz", with_twin(bundle, alpha=(0.25, 0.5)))
    assert fault == "manifest.json: twin: alpha has 2 numbers; expected 1"


def test_what_cannot_be_written_leaves_no_file(bundle: Bundle, tmp_path: Path, fault_of: Callable) -> None:
    made = with_twin(bundle, alpha=(float("nan"),))
    assert fault_of(write_bundle, tmp_path / "a.npz", made).startswith("cannot be written: manifest.json is not JSON: ")
    assert not (tmp_path / "a.npz").exists()


def test_faults_of_its_arrays(bundle: Bundle, tmp_path: Path, fault_of: Callable) -> None:
    """Missing, unexpected, of another shape, not finite; and the surface's own fields."""
    made = with_twin(bundle)
    assert made.twin is not None
    surface, key = made.twin.surface, "opacity/last/bias"
    rest = {k: x for k, x in surface.arrays.items() if k != key}
    for arrays, fault in (
        (rest, "array twin/opacity/last/bias is missing"),
        (surface.arrays | {"more": np.zeros(1, np.float32)}, "unexpected array 'twin/more'"),
        (
            rest | {key: np.zeros(2, np.float32)},
            "array twin/opacity/last/bias is float32 of shape (2,); expected shape (1,)",
        ),
        (rest | {key: np.full(1, np.inf, np.float32)}, "array twin/opacity/last/bias has NaN or infinite values"),
    ):
        other = replace(made, twin=replace(made.twin, surface=replace(surface, arrays=arrays)))
        assert fault_of(write_bundle, tmp_path / "a.npz", other) == fault
    other = replace(made, twin=replace(made.twin, surface=replace(surface, depth=-1.0)))
    assert fault_of(write_bundle, tmp_path / "a.npz", other) == "manifest.json: twin: depth is -1.0"
