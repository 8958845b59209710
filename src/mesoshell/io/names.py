"""Distinct names for several paths."""

from collections.abc import Sequence
from os import PathLike
from os.path import abspath
from pathlib import Path


def distinct_names(paths: Sequence[str | PathLike[str]]) -> list[str]:
    """A name for each path, without .npz: its last parts, as many as make it unique, joined by underscores. If a path occurs
    twice, all names are numbered."""
    parts = [Path(abspath(str(p).removesuffix(".npz"))).parts for p in paths]
    for depth in range(1, max(map(len, parts), default=0) + 1):
        names = ["_".join(p[-depth:]).replace("/", "") for p in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{p[-1]}_{i}" for i, p in enumerate(parts, 1)]
