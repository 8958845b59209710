"""Limits of the process: as many files as are mapped."""

import resource
from collections.abc import Iterator

import pytest

from mesoshell.limits import SPARE, allow_files


@pytest.fixture
def limit() -> Iterator[int]:
    """A soft limit of 512 files."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (512, before[1]))
    yield before[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_as_many_files_as_are_mapped_may_be_open(limit: int):
    def soft() -> int:
        return resource.getrlimit(resource.RLIMIT_NOFILE)[0]

    allow_files(512 - SPARE)
    assert soft() == 512
    allow_files(600)
    assert soft() == 600 + SPARE
    allow_files(3)
    assert soft() == 600 + SPARE
    if limit != resource.RLIM_INFINITY:
        allow_files(2 * limit)
        assert soft() == limit
