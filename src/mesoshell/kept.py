"""Keep what was made of things that cannot change: a viewer's next picture shares most of its last one's tables (NumPy only).

Notation
constant    a number, a word, None; an array that cannot be written to; a frozen dataclass of such arrays; a tuple of constants
"""

import weakref
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import wraps
from itertools import chain
from threading import RLock
from typing import Any, NamedTuple, TypeVar, TypeVarTuple

import numpy as np

T = TypeVar("T")
Given = TypeVarTuple("Given")

#: Results that a function keeps.
MOST = 4


class _Entry(NamedTuple):
    """A result; the arrays that it was made of; and what forgets it when one of its arguments is gone."""

    result: Any
    arrays: list[np.ndarray]
    ends: list[weakref.finalize]


def kept(make: Callable[[*Given], T]) -> Callable[[*Given], T]:
    """A function that makes nothing twice of the same constants: it returns what it made of them last, while they live. What
    it makes must not hold its arguments, which would then never be freed. Arguments are given by position."""
    entries: dict[tuple, _Entry] = {}
    lock = RLock()

    def forget(key: tuple) -> None:
        with lock:
            entry = entries.pop(key, None)
        for end in entry.ends if entry is not None else ():
            end.detach()

    @wraps(make)
    def get(*given: *Given) -> T:
        if not all(map(is_constant, given)):
            return make(*given)
        key, arrays = tuple(_name(x) for x in given), list(chain.from_iterable(map(_arrays, given)))
        with lock:
            entry = entries.get(key)
        # a dictionary of a dataclass may hold others by now
        if entry is not None and len(entry.arrays) == len(arrays) and all(map(_same, entry.arrays, arrays)):
            return entry.result
        result = make(*given)
        with lock:
            forget(key)
            for old in list(entries)[: max(0, len(entries) + 1 - MOST)]:
                forget(old)
            ends = [weakref.finalize(x, forget, key) for x in _objects(given)]
            for end in ends:
                end.atexit = False
            entries[key] = _Entry(result, arrays, ends)
        return result

    return get


def is_constant(x: Any) -> bool:
    """Whether it is a constant."""
    if _is_plain(x):
        return True
    if isinstance(x, tuple):
        return all(map(is_constant, x))
    frozen = is_dataclass(x) and x.__dataclass_params__.frozen  # type: ignore[attr-defined]
    return (isinstance(x, np.ndarray) or frozen) and not any(
        a.flags.writeable for own in _arrays(x) for a in _bases(own)
    )


def constant(x: T) -> T:
    """A dataclass, with arrays that cannot be written to from now on."""
    for array in _arrays(x):
        for a in _bases(array):
            a.setflags(write=False)
    return x


def _arrays(x: Any) -> Iterator[np.ndarray]:
    """The arrays in something."""
    if isinstance(x, np.ndarray):
        yield x
    elif isinstance(x, tuple | list):
        yield from chain.from_iterable(map(_arrays, x))
    elif isinstance(x, Mapping):
        yield from chain.from_iterable(map(_arrays, x.values()))
    elif is_dataclass(x):
        yield from chain.from_iterable(_arrays(getattr(x, field.name)) for field in fields(x))


def _bases(x: Any) -> Iterator[np.ndarray]:
    """An array, and those whose memory it shows."""
    while isinstance(x, np.ndarray):
        yield x
        x = x.base


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return a is b


def _is_plain(x: Any) -> bool:
    return x is None or isinstance(x, str | int | float)


def _name(x: Any) -> Any:
    """What tells a constant from others while it lives."""
    if isinstance(x, tuple):
        return tuple(map(_name, x))
    return (type(x), x) if _is_plain(x) else ("object", id(x))


def _objects(x: Any) -> list[Any]:
    """The objects in nested tuples."""
    if isinstance(x, tuple):
        return [y for part in x for y in _objects(part)]
    return [] if _is_plain(x) else [x]
