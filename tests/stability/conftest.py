"""Hard cases are those of the program that users run: rounding is another where the compiler optimises."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def _as_users_have_it(optimised) -> None:
    pass
