"""A fit refuses images of more than one geometry."""

from pathlib import Path

import pytest

from mesoshell.cli.fitting import _one_patch
from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset

ROLES = {"length": {"role": "beta"}, "hue": {"role": "alpha"}}


def dataset(name: str, patch: int | None, **fixed: float) -> Dataset:
    return Dataset(Path(name), "fur", {"patch": patch, "parameters": ROLES, "fixed_parameters": fixed}, ())


def test_one_patch_with_fixed_geometry_passes() -> None:
    _one_patch([dataset("a", 0, length=0.5), dataset("b", 0, length=0.5, hue=0.1)])


@pytest.mark.parametrize(
    ("second", "fault"),
    [
        (dataset("b", None, length=0.5), "b: every image shows another geometry; render it with --patch 0 for a fit"),
        (dataset("b", 1, length=0.5), "b: shows another geometry than the first dataset"),
        (dataset("b", 0, length=0.6), "b: shows another geometry than the first dataset"),
    ],
)
def test_another_geometry_is_refused(second: Dataset, fault: str) -> None:
    with pytest.raises(InputError) as caught:
        _one_patch([dataset("a", 0, length=0.5), second])
    assert str(caught.value) == fault


def test_a_geometry_that_varies_is_refused() -> None:
    with pytest.raises(InputError, match="a: its geometry varies with length; fix it with --param length=VALUE"):
        _one_patch([dataset("a", 0)])
