"""Contact sheets of the small dataset: three grey images, (1 + index) / 8, with age 0.25 · index."""

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.dataset import read_dataset
from mesoshell.io.sheet import contact_sheet


def greys(sheet: np.ndarray, columns: int) -> list[float]:
    """Value in the middle of each image; images are 6 × 4 pixels, 2 apart."""
    rows = (sheet.shape[0] - 2) // 6
    return [float(sheet[2 + 6 * r + 2, 2 + 8 * c + 3, 0]) for r in range(rows) for c in range(columns)]


def shown(index: int) -> float:
    x = (1 + index) / 8  # radiance and alpha alike
    return x / (1 + x) + 0.05 * (1 - x)


@pytest.mark.parametrize("columns", [1, 2, 3, 9])
def test_images_stand_row_by_row(folder, columns: int):
    sheet = contact_sheet(read_dataset(folder.path), columns=columns)
    wide = min(columns, 3)
    assert sheet.shape == (-(-3 // wide) * 6 + 2, wide * 8 + 2, 3)
    np.testing.assert_allclose(greys(sheet, wide)[:3], [shown(i) for i in range(3)], rtol=1e-3)


def test_sorted_by_a_parameter_and_thinned_evenly(folder):
    for index, age in enumerate((0.9, 0.1, 0.5)):
        folder.change_row(index, {"parameters": {"age": age}})
    dataset = read_dataset(folder.path)
    np.testing.assert_allclose(greys(contact_sheet(dataset, "age"), 3), [shown(i) for i in (1, 2, 0)], rtol=1e-3)
    np.testing.assert_allclose(greys(contact_sheet(dataset, "age", 2), 2), [shown(i) for i in (1, 0)], rtol=1e-3)


def test_an_unknown_order_names_the_known_ones(folder):
    with pytest.raises(InputError, match="cannot be sorted by 'length'; there are: age, radius"):
        contact_sheet(read_dataset(folder.path), "length")
