"""A farm of stand-ins for Blender."""

from collections.abc import Callable
from pathlib import Path

import pytest

from mesoshell.datasets.blender.render import DatasetReport, Farm, render_dataset
from tests.helpers.stand_ins import STAND_IN, ignore, settings


@pytest.fixture
def farm() -> Callable[..., DatasetReport]:
    """farm(folder, count, recipe, workers, show) renders with stand-ins and returns the report."""

    def farm(
        folder: Path, count: int, recipe: str = "grass", workers: int = 1, show: Callable = ignore
    ) -> DatasetReport:
        return render_dataset(settings(recipe), count, folder, Farm(workers, 1, None, STAND_IN), show)

    return farm
