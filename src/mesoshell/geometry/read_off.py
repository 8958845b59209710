"""Read OFF files of text: polygons of any size, as fans of triangles; colours and normals are ignored.

Notation
n           corners of a polygon, its line's first number; then follow their vertices, from 0, and perhaps a colour
"""

from os import PathLike
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from mesoshell.errors import InputError


def read_off(path: str | PathLike[str]) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"], None]:
    """Vertices, triangles and no texture coordinates. Raises InputError that names the line at fault."""
    text = Path(path).read_text(errors="replace")
    lines = [(k, x) for k, x in enumerate((line.split("#")[0].split() for line in text.splitlines()), 1) if x]
    head, counts = lines[0][1], lines[0][1][1:] or lines[1][1]
    if "4" in head[0] or "n" in head[0]:
        raise InputError(path, f"is of {head[0]}, whose vertices are not of three numbers")
    body = lines[1 if len(head) > 1 else 2 :]
    points: list[list[float]] = []
    corners: list[list[int]] = []
    vertices, faces = int(counts[0]), int(counts[1])
    for k, (number, words) in enumerate(body[: vertices + faces]):
        try:
            if k < vertices:
                points.append([float(x) for x in words[:3]])
                if len(words) < 3:
                    raise ValueError(f"needs 3 numbers and has {len(words)}")
            else:
                polygon = [int(x) for x in words[1 : 1 + int(words[0])]]
                if not 3 <= int(words[0]) == len(polygon):
                    raise ValueError(f"a face of {words[0]} has {len(polygon)} corners")
                if not all(0 <= x < vertices for x in polygon):
                    raise ValueError(f"face refers to a vertex beyond {vertices}")
                corners += [[polygon[0], *polygon[i : i + 2]] for i in range(1, len(polygon) - 1)]
        except ValueError as fault:
            raise InputError(path, f"line {number}: {fault}") from None
    return np.array(points, np.float64).reshape(-1, 3), np.array(corners, np.int64).reshape(-1, 3), None
