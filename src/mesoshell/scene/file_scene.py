"""What a file of a scene says beside its meshes: a camera, suns, lamps, a sky, the axis that is up, and materials that grow on
its own nodes (no JAX).

Notation
mesoshell:material      attribute of a node: the name, or the file beside the scene's, of the material that grows on it
mesoshell:NAME          any other: a value of that material, as `--param NODE:NAME` sets it
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.geometry.mesh import FARTHEST
from mesoshell.render.lamp import Lamp, fault_of
from mesoshell.render.light import Distant
from mesoshell.scene.dome import Dome

#: What attributes begin with that are read here.
OURS = "mesoshell:"


class Worn(NamedTuple):
    """A node that names the material that grows on it. node: as `Scene.grow` takes it; values: as `--param` takes them."""

    node: str
    material: str
    values: dict[str, str]


@dataclass(frozen=True)
class FileScene:
    """camera: its frame and vertical field of view, radians, or None; aspect: width over height that it was made for, or None;
    suns; lamps; notes: what the user should know, a line each; up: the axis, "y" or "z"; sky: a dome light, or None; worn: the
    nodes that name their materials."""

    camera: tuple[Float[np.ndarray, "4 4"], float] | None
    aspect: float | None
    suns: tuple[Distant, ...]
    notes: tuple[str, ...]
    up: str = "y"
    sky: Dome | None = None
    lamps: tuple[Lamp, ...] = ()
    worn: tuple[Worn, ...] = ()


def worn_of(
    nodes: Iterable[tuple[str, Mapping[str, Any]]], seen: Iterable[Sequence[str]], path: Path
) -> tuple[tuple[Worn, ...], list[str]]:
    """What nodes, by their names, say by their attributes; and notes on those on which nothing grows. seen: of each part that
    is seen, the names by which it may be grown on, the nearest first; path: of the scene's file. Raises InputError."""
    worn: dict[str, Worn] = {}
    for node, attributes in nodes:
        one = _worn_by(node, attributes, path)
        if one is not None and worn.setdefault(node, one) != one:
            raise InputError(path, f"{node}: several nodes have this name, and attributes that differ")
    used = {next((name for name in names if name in worn), "") for names in seen} if worn else set[str]()
    idle = [node for node in worn if node not in used]
    notes = [f"nothing is seen of what {', '.join(idle[:5])}{' and more' * (len(idle) > 5)} would grow on"]
    return tuple(x for node, x in worn.items() if node in used), notes if idle else []


def _worn_by(node: str, attributes: Mapping[str, Any], path: Path) -> Worn | None:
    """What a node's attributes say, of those that begin with OURS; None without any."""
    ours = {name.removeprefix(OURS): value for name, value in attributes.items() if name.startswith(OURS)}
    said = {}
    for name, value in ours.items():
        beside = path.parent / value if isinstance(value, str) else path
        if isinstance(value, str) and value:
            said[name] = str(beside) if beside.is_file() else value
        elif isinstance(value, int | float) and not isinstance(value, bool):
            said[name] = repr(value)
        else:
            raise InputError(path, f"{node}: {OURS}{name} is neither a text nor a number: {value!r}")
    if said and not isinstance(ours.get("material"), str):
        others = ", ".join(f"{OURS}{name}" for name in said if name != "material")
        fault = f"has {others}, and no {OURS}material" if "material" not in said else f"{OURS}material is no text"
        raise InputError(path, f"{node}: {fault}")
    return Worn(node, said.pop("material"), said) if said else None


def frame_of(to_world: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """The frame of a camera that looks along −z, without its node's scale: right, up, back, where it stands. Raises
    ValueError."""
    if not np.abs(to_world).max() <= FARTHEST:
        raise ValueError("a camera's transform holds a number that is not finite, or too large")
    back, up = _unit(to_world[:3, 2]), to_world[:3, 1]
    right = _unit(np.cross(up, back))
    out = np.eye(4)
    out[:3] = np.stack([right, np.cross(back, right), back, to_world[:3, 3]], axis=1)
    return out


def sun_of(to_world: Float[np.ndarray, "4 4"], irradiance: Float[np.ndarray, "3"]) -> Distant:
    """A light that shines along −z. Raises ValueError for a strength that none can have."""
    if irradiance.shape != (3,) or not ((irradiance >= 0) & (irradiance < 1e30)).all():
        raise ValueError(f"a sun has the irradiance {irradiance.tolist()}")
    return Distant(_unit(to_world[:3, 2]), irradiance)


def lamp_fault(lamp: Lamp) -> str:
    """Why a lamp cannot be; empty if it can."""
    return fault_of(lamp, FARTHEST, 1e30)


def _unit(v: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    length = float(np.linalg.norm(v))
    if not 0 < length < np.inf:
        raise ValueError("a camera or a light has no direction")
    return v / length
