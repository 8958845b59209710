"""Arrays of a bundle: which there are, of what shape and type, and whether their numbers can be (NumPy only).

Symbols are those of io/bundle.
"""

from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.archive import Head
from mesoshell.io.corner_tiles import SIDE
from mesoshell.io.twin import PREFIX, check_twin_heads

_EITHER = ("float16", "float32")

#: key: (shape in symbols, types)
SHELL: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "features/{i}": (("H{i}", "W{i}", "C"), _EITHER),
    "height/{i}": (("R{i}", "C"), _EITHER),
    "heights/{i}": (("P", "Q", "R{i}", "C"), _EITHER),
    "correction": (("L", "B", "C"), _EITHER),
    "decoder/trunk/{i}/kernel": (("T{i}", "T{j}"), _EITHER),  # T0 = C + E + A
    "decoder/trunk/{i}/bias": (("T{j}",), _EITHER),
    "decoder/sigma/kernel": (("T", "1"), _EITHER),
    "decoder/sigma/bias": (("1",), _EITHER),
    "decoder/head/{i}/kernel": (("S{i}", "S{j}"), _EITHER),  # S0 = T + 6
    "decoder/head/{i}/bias": (("S{j}",), _EITHER),
    "decoder/rho/kernel": (("S", "3"), _EITHER),
    "decoder/rho/bias": (("3",), _EITHER),
    "sigma_scale": ((), ("float32",)),
    "grid/{i}": (("any", "any", "any"), _EITHER),
}

#: What is there if the texture is baked.
BAKED = ("features/", "height/", "heights/", "grid/")
_NON_NEGATIVE = ("sigma_scale", "grid/")
#: Numbers that are looked at at a time: a folder's arrays may be larger than memory.
_BLOCK = 2**24


def _sizes(fields: dict[str, Any], heads: dict[str, Head]) -> tuple[dict[str, int], dict[str, int]]:
    """(Size of each symbol, members of each family); a missing or empty axis counts 1: its fault shows later."""

    def axis(key: str, k: int) -> int:
        shape = heads[key][0] if key in heads else ()
        return max(1, shape[k]) if k < len(shape) else 1

    first = {"H": axis("features/0", 0), "W": axis("features/0", 1), "R": axis("height/0", 0)}
    texels = max(1, int(fields["texel_density"]))
    across = max(first["H"], first["W"]) if fields["wraps"] else texels
    levels = across.bit_length()
    rows = first["R"].bit_length()
    sizes = {}
    for letter, n in first.items():
        up = letter != "R" and not fields["wraps"]
        sizes |= {f"{letter}{i}": -(-n >> i) if up else max(1, n >> i) for i in range(max(levels, rows))}
    sizes |= {"C": fields["channels"], "1": 1, "3": 3}
    sizes |= {"L": levels, "B": axis("correction", 1)}
    sizes |= {"P": -(-first["H"] // texels) + 1, "Q": -(-first["W"] // texels) + 1}
    counts = {"features": levels, "height": rows, "heights": rows if "heights/0" in heads else 0, "grid": levels}
    counts["correction"] = int("correction" in heads)
    alpha = sum(parameter.role == "alpha" for parameter in fields["parameters"])
    width = fields["channels"] + 1 + 2 * fields["height_octaves"] + alpha
    for letter, family in (("T", "decoder/trunk"), ("S", "decoder/head")):
        i = 0
        while i == 0 or f"{family}/{i}/kernel" in heads:
            sizes[f"{letter}{i}"], width, i = width, axis(f"{family}/{i}/kernel", 1), i + 1
        sizes[f"{letter}{i}"] = sizes[letter] = width
        counts[family] = i
        width += 6
    return sizes, counts


def check_heads(path: str | PathLike[str], fields: dict[str, Any], heads: dict[str, Head]) -> None:
    """The arrays against `SHELL`, in both directions, by name, shape and type."""
    if fields["twin"] is not None:
        check_twin_heads(path, fields["twin"], {key: head for key, head in heads.items() if key.startswith(PREFIX)})
        heads = {key: head for key, head in heads.items() if not key.startswith(PREFIX)}
    sizes, counts = _sizes(fields, heads)
    expected = {
        pattern.format(i=i, j=i + 1): ([symbol.format(i=i, j=i + 1) for symbol in symbols], types)
        for pattern, (symbols, types) in SHELL.items()
        for i in range(counts.get(pattern.partition("/{i}")[0], 1))
    }
    if fields["tiles"] is not None and "heights/0" in heads:
        raise InputError(path, "array heights/0: corner tiles have one height feature")
    made = fields["generator"] is not None
    if made and not any(key.startswith(BAKED) for key in heads):
        expected = {key: entry for key, entry in expected.items() if not key.startswith(BAKED)}
    weights = {key for key in heads if made and key.startswith("generator/")}
    for key in sorted(expected.keys() - heads.keys()):
        raise InputError(path, f"array {key} is missing")
    for key in sorted(heads.keys() - expected.keys() - weights):
        raise InputError(path, f"unexpected array {key!r}")
    for key in weights:
        if str(heads[key][1]) not in _EITHER:
            raise InputError(path, f"array {key} holds {heads[key][1]}; expected {' or '.join(_EITHER)}")
    for key, (symbols, types) in expected.items():
        shape, dtype = heads[key]
        sides = [sizes.get(symbol, "any") for symbol in symbols]
        if len(shape) != len(sides) or not all(n == m or (n and m == "any") for n, m in zip(shape, sides, strict=True)):
            raise InputError(path, f"array {key} has shape {_row(shape)}; expected {_row(symbols)} = {_row(sides)}")
        if str(dtype) not in types:
            raise InputError(path, f"array {key} holds {dtype}; expected {' or '.join(types)}")
    if "features/0" in expected:
        _check_texture(path, fields, heads["features/0"][0])


def _check_texture(path: str | PathLike[str], fields: dict[str, Any], shape: tuple[int, ...]) -> None:
    height, width, _ = shape
    density = fields["texel_density"]
    if fields["wraps"] and (height & (height - 1) or width & (width - 1)):
        raise InputError(path, f"features/0 is {height} × {width} texels; expected powers of two")
    if fields["tiles"] is not None and not (height == width == SIDE * density):
        wanted = f"{SIDE * density:g} × {SIDE * density:g}"
        raise InputError(path, f"features/0 of corner tiles is {height} × {width} texels; expected {wanted}")
    if not fields["wraps"] and (density != int(density) or int(density) & (int(density) - 1)):
        raise InputError(path, f"texel_density is {density:g}; expected a power of two where the texture has edges")


def _row(sides: Sequence[int | str]) -> str:
    return f"({', '.join(map(str, sides))})"


def check_values(path: str | PathLike[str], arrays: dict[str, np.ndarray]) -> None:
    """Raise InputError if an array holds NaN, infinity, or a negative value where there must be none."""
    for key, array in arrays.items():
        rows = max(1, _BLOCK * max(1, len(array)) // max(1, array.size)) if array.ndim else 1
        for block in (array[i : i + rows] for i in range(0, len(array), rows)) if array.ndim else [array]:
            if not np.isfinite(block).all():
                raise InputError(path, f"array {key} has NaN or infinite values")
            if key.startswith(_NON_NEGATIVE) and block.min() < 0:
                raise InputError(path, f"array {key} has negative values")
