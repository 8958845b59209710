"""What is done to good files, by a seed: bytes cut, flipped, doubled, cleared or made large, and values of other kinds."""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

#: Values that any field of a JSON text may be given.
VALUES = [None, -1, 0, 1e308, 10**40, float("nan"), "x", "", [], {}, True, [10**9, 10**9], [[0] * 4] * 4]
VALUES += ["a\0b", "a\nb", "../../x", "n" * 5000, "\ud800", [None] * 3]

WAYS = ("cut", "flipped", "doubled", "cleared", "large", "marked", "other end", "strewn", "lines")


def damaged(data: bytes, seed: int) -> bytes:
    """One of WAYS, at a place of the seed's."""
    random = np.random.default_rng(seed)
    at = int(random.integers(max(1, len(data))))
    match WAYS[seed % len(WAYS)]:
        case "cut":
            return data[:at]
        case "flipped":
            return data[:at] + bytes([data[at] ^ (1 << int(random.integers(8)))]) + data[at + 1 :]
        case "doubled":
            return data[:at] + data[at // 2 :]
        case "cleared":
            return data[:at] + bytes(min(64, len(data) - at)) + data[at + 64 :]
        case "large":
            return data[:at] + b"\xff\xff\xff\x7f" + data[at + 4 :]
        case "marked":
            return b"\xef\xbb\xbf" + data
        case "other end":
            return data[::-1]
        case "strewn":
            out = bytearray(data)
            for i in random.integers(len(data), size=8):
                out[i] = int(random.integers(256))
            return bytes(out)
    return data.replace(b"\n", b"\r")


#: What lies at a place where a file, or a folder, is looked for.
THINGS: dict[str, Callable[[Path], Any]] = {
    "nothing": lambda path: None,
    "a folder": lambda path: path.mkdir(),
    "a link to nothing": lambda path: path.symlink_to("nowhere"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "an empty file": lambda path: path.write_bytes(b""),
    "a socket's file": lambda path: os.mknod(path, 0o140644),
    "utf-16": lambda path: path.write_bytes("v 0 0 0\nf 1 1 1\n".encode("utf-16")),
    "nested": lambda path: path.write_bytes(b'{"frames":' * 50_000),
    "zeros": lambda path: path.write_bytes(bytes(5000)),
}


def replaced(said: Any, seed: int, inside: bool = False) -> tuple[str, Any]:
    """A copy of an object with one field, of an object inside it if asked for, given one of VALUES, removed, or added."""
    random = np.random.default_rng(seed)
    said = json.loads(json.dumps(said))
    into = said
    while True:
        deeper = [x for x in (into.values() if isinstance(into, dict) else into) if isinstance(x, dict | list) and x]
        if not deeper or (not inside and into is said) or random.random() < 0.3:
            break
        into = deeper[int(random.integers(len(deeper)))]
    key = list(into)[int(random.integers(len(into)))] if isinstance(into, dict) else int(random.integers(len(into)))
    what = int(random.integers(len(VALUES) + 2))
    if what == len(VALUES):
        del into[key]
    elif what > len(VALUES) and isinstance(into, dict):
        into["another"] = 1
    else:
        into[key] = VALUES[what % len(VALUES)]
    return f"{key}, {what}", said


def variants(said: Any, count: int) -> Iterator[tuple[str, Any]]:
    """Fields of the object itself, and of what is in it, in turn."""
    for seed in range(count):
        yield replaced(said, seed, inside=seed % 2 == 1)
