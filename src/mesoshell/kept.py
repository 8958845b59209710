"""Keep what was made of things that cannot change: a viewer's next picture shares most of its last one's tables (NumPy only).

Notation
constant    a number, a word, None; an array, a frozen dataclass or a tuple, if none of its arrays can be written to
"""

import weakref
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import wraps
from itertools import chain
from threading import Lock
from typing import Any, TypeVar, TypeVarTuple

import numpy as np

T = TypeVar("T")
Given = TypeVarTuple("Given")

#: Results that a function keeps: of two scenes, to compare them.
MOST = 2


def kept(make: Callable[[*Given], T]) -> Callable[[*Given], T]:
    """A function that makes nothing twice of the same constants: it returns what it made of them last, while they live. What
    it makes must not hold its arguments, which would then never be freed. Arguments are given by position."""
    results: dict[tuple, T] = {}
    lock = Lock()

    @wraps(make)
    def get(*given: *Given) -> T:
        if not all(map(is_constant, given)):
            return make(*given)
        key = tuple(_name(x) for x in given)
        with lock:
            if key in results:
                return results[key]
        result = make(*given)
        with lock:
            while len(results) >= MOST:
                results.pop(next(iter(results)), None)
            results[key] = result
        for x in _objects(given):
            weakref.finalize(x, results.pop, key, None).atexit = False
        return result

    return get


def is_constant(x: Any) -> bool:
    """Whether it is a constant."""
    if x is None or isinstance(x, str | int | float):
        return True
    return (isinstance(x, np.ndarray | tuple) or is_dataclass(x)) and not any(a.flags.writeable for a in _arrays(x))


def constant(x: T) -> T:
    """A dataclass, with arrays that cannot be written to from now on."""
    for array in _arrays(x):
        array.setflags(write=False)
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


def _name(x: Any) -> Any:
    """What tells a constant from others while it lives."""
    if isinstance(x, tuple):
        return tuple(map(_name, x))
    return (type(x), x) if x is None or isinstance(x, str | int | float) else ("object", id(x))


def _objects(x: Any) -> list[Any]:
    """The objects in nested tuples."""
    if isinstance(x, tuple):
        return [y for part in x for y in _objects(part)]
    return [] if x is None or isinstance(x, str | int | float) else [x]
