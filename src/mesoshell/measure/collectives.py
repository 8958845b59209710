"""What a compiled program sends between devices, read from its HLO text.

Notation
kind        all-reduce, all-gather, reduce-scatter, all-to-all, collective-permute
bytes       that a device holds after it: in a ring of n devices each sends and receives (n−1)/n of them, for an all-reduce
            twice that
some        whether it is in a branch of a condition, so done at some steps only
turns       iterations of the loop around it
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
    """One collective of a program. parts: arrays that it sends together; the others: see above."""

    kind: str
    bytes: int
    parts: int
    some: bool
    turns: int


def collectives_of(text: str) -> list[Collective]:
    """The collectives in a compiled program's HLO text, as `jax.stages.Compiled.as_text` gives it."""
    bodies = _computations(text)
    within: dict[str, tuple[bool, int]] = {}
    entry = re.search(r"^ENTRY %?([\w.\-]+)", text, re.M)
    _visit(bodies, entry.group(1) if entry else next(iter(bodies), ""), (False, 1), within)
    return [
        _collective(match, *within[name])
        for name, lines in bodies.items()
        if name in within
        for line in lines
        if (match := _MADE.search(line))
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
        branches = [x.strip(" %") for many, one in _BRANCHES.findall(line) for x in (*many.split(","), one)]
        for called in _CALLED.findall(line) + [x for x in branches if x]:
            _visit(bodies, called, (some or called in branches, turns), within)


def _collective(match: re.Match, some: bool, turns: int) -> Collective:
    arrays = _SHAPE.findall(match.group(1))
    if (
        match.group(3) and match.group(2) != "all-reduce"
    ):  # the start of an asynchronous one gives a pair, inputs and outputs
        arrays = arrays[len(arrays) // 2 :]
    size = sum(_bytes(kind, shape) for kind, shape in arrays)
    return Collective(match.group(2), size, len(arrays), some, turns)


def _bytes(kind: str, shape: str) -> int:
    count = 1
    for n in shape.split(","):
        count *= int(n) if n else 1
    return count * _WIDTH.get(kind, 4)
