"""What users call renders and grows textures: that runs longer than it compiles."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def _as_users_have_it(optimised) -> None:
    pass
