"""What a compiled program sends between devices, read in its text.

Notation
kind        all-reduce, all-gather, reduce-scatter, all-to-all, collective-permute
bytes       of what a device holds after it: a ring of n devices sends and receives (n−1)/n of it in each direction, an
            all-reduce twice that
some        whether it is in a branch of a condition: done at some steps only
turns       of the loop about it
"""

import re
from typing import NamedTuple

_KINDS = ("all-reduce", "all-gather", "reduce-scatter", "all-to-all", "collective-permute")
_WIDTH = {"pred": 1, "s8": 1, "u8": 1, "s16": 2, "u16": 2, "f16": 2, "bf16": 2, "s64": 8, "u64": 8, "f64": 8, "c64": 8}
_HEAD = re.compile(r"^(?:ENTRY )?%?([\w.\-]+) .*\{\s*$")
_MADE = re.compile(rf"= (.*?) ({'|'.join(_KINDS)})(-start)?\(")
_SHAPE = re.compile(r"\b([a-z]+\d*)\[([\d,]*)\]")
_CALLED = re.compile(r"(?:to_apply|body|condition|calls|true_computation|false_computation)=%?([\w.\-]+)")
_BRANCHES = re.compile(r"branch_computations=\{([^}]*)\}|(?:true|false)_computation=(%?[\w.\-]+)")
_TURNS = re.compile(r'known_trip_count":\{"n":"(\d+)"\}')


class Collective(NamedTuple):
    """One of a program's, done `turns` times where it is done. parts: arrays that it sends together."""

    kind: str
    bytes: int
    parts: int
    some: bool
    turns: int


def collectives_of(text: str) -> list[Collective]:
    """Those of a compiled program's text (HLO), as `jax.stages.Compiled.as_text` gives it."""
    bodies = _computations(text)
    within: dict[str, tuple[bool, int]] = {}
    entry = re.search(r"^ENTRY %?([\w.\-]+)", text, re.M)
    _visit(bodies, entry.group(1) if entry else next(iter(bodies), ""), (False, 1), within)
    return [
        _collective(found, *within[name])
        for name, lines in bodies.items()
        if name in within
        for line in lines
        if (found := _MADE.search(line))
    ]


def _computations(text: str) -> dict[str, list[str]]:
    bodies: dict[str, list[str]] = {}
    name = ""
    for line in text.splitlines():
        head = None if line.startswith(" ") else _HEAD.match(line)
        if head:
            name = head.group(1)
            bodies[name] = []
        elif name:
            bodies[name].append(line)
    return bodies


def _visit(bodies: dict, name: str, at: tuple[bool, int], within: dict[str, tuple[bool, int]]) -> None:
    """Mark what a computation calls: in a branch or not, and how many turns."""
    if name not in bodies or name in within:
        return
    within[name] = at
    for line in bodies[name]:
        some, turns = at
        known = _TURNS.search(line)
        turns *= int(known.group(1)) if known else 1
        branches = [x.strip(" %") for found in _BRANCHES.findall(line) for x in (*found[0].split(","), found[1])]
        for called in _CALLED.findall(line) + [x for x in branches if x]:
            _visit(bodies, called, (some or called in branches, turns), within)


def _collective(found: re.Match, some: bool, turns: int) -> Collective:
    arrays = _SHAPE.findall(found.group(1))
    if found.group(3) and found.group(2) != "all-reduce":  # what is begun is a pair: what goes in, what comes out
        arrays = arrays[len(arrays) // 2 :]
    size = sum(_bytes(kind, shape) for kind, shape in arrays)
    return Collective(found.group(2), size, len(arrays), some, turns)


def _bytes(kind: str, shape: str) -> int:
    count = 1
    for n in shape.split(","):
        count *= int(n) if n else 1
    return count * _WIDTH.get(kind, 4)
