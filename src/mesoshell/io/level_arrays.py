"""Arrays of one name, NAME/0, NAME/1, …, that lie one after the other in memory, so that a lookup takes them as one table and a
mapped file is never copied (NumPy only)."""

import math
from collections.abc import Sequence
from itertools import accumulate, pairwise

import numpy as np


def split(flat: np.ndarray, shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
    """Views of a flat array, one for each shape. Raises ValueError if its length is not theirs together."""
    ends = [*accumulate((math.prod(shape) for shape in shapes), initial=0)]
    if flat.ndim != 1 or len(flat) != ends[-1]:
        raise ValueError(f"{flat.shape} is not an array of {ends[-1]} numbers")
    return [flat[begin:end].reshape(shape) for shape, (begin, end) in zip(shapes, pairwise(ends), strict=True)]


def flatten(levels: Sequence[np.ndarray]) -> np.ndarray:
    """All numbers of one level or more, one level after the other: a view if they lie so in memory, else a copy."""
    whole = _owner(levels[0])
    begin, length = _address(levels[0]) - _address(whole), sum(level.nbytes for level in levels)
    at = _address(levels[0])
    for level in levels:
        in_row = level.flags.c_contiguous and _owner(level) is whole and level.dtype == levels[0].dtype
        if not in_row or _address(level) != at or not whole.flags.c_contiguous:
            return np.concatenate([x.ravel() for x in levels])
        at += level.nbytes
    return whole.reshape(-1).view(np.uint8)[begin : begin + length].view(levels[0].dtype)


def _owner(array: np.ndarray) -> np.ndarray:
    """The array whose memory this one is a view of."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def _address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]
