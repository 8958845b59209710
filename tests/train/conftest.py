"""Training steps take longer to compile than to run."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def _compiled_soon(barely_optimised) -> None:
    pass
