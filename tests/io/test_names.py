"""Names that tell paths apart."""

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from mesoshell.io.names import distinct_names


def test_the_last_part_where_it_is_enough() -> None:
    assert distinct_names(["/a/test", "/a/grass.npz"]) == ["test", "grass"]
    assert distinct_names(["/a/test", "/b/test"]) == ["a_test", "b_test"]
    assert distinct_names(["/a/test", "/a/test"]) == ["test_1", "test_2"]
    assert distinct_names([]) == []


@given(st.lists(st.lists(st.sampled_from(["a", "b", "a_b"]), min_size=1, max_size=3), max_size=5))
def test_as_many_names_as_paths(paths: list[list[str]]) -> None:
    names = distinct_names([Path("/", *parts) for parts in paths])
    assert len(names) == len(paths) == len(set(names))
