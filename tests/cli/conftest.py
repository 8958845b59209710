"""What users call renders and grows textures: that runs longer than it compiles, but in a few files."""

import pytest

#: Files whose programs take longer to compile than to run.
COMPILED_SOON = {"test_twin_cli", "test_generator_cli", "test_judge_cli", "test_surface_cli"}


@pytest.fixture(scope="module", autouse=True)
def _as_users_have_it(request: pytest.FixtureRequest) -> None:
    if request.module.__name__.rpartition(".")[2] not in COMPILED_SOON:
        request.getfixturevalue("optimised")
