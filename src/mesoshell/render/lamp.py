"""Lamps: lights that stand somewhere. Engine mitsuba has them as they are; for engine jax each is a distant light (NumPy only).

Notation
I            radiant intensity of a point or a spot, RGB                                                W/sr
L            radiance of what has an extent, RGB                                                        W/(m² sr)
n            unit direction in which a spot, a rectangle or a disk shines
A            area of a rectangle, 4 |x × y|, or a disk, π |x × y|, of the pose's columns x and y
E⊥           irradiance on the plane facing the lamp, a distance d away: I / d²; L π r² / d² of a sphere of radius r;
             L A cos θ / (d² + A / π) of a rectangle or a disk seen at an angle θ from n, exact on the axis of a disk
"""

from typing import Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Float

from mesoshell.render.light import Distant

Kind = Literal["point", "spot", "sphere", "rectangle", "disk"]
#: Those that a ray can meet.
EXTENDED = ("sphere", "rectangle", "disk")
#: Least distance at which a lamp lights a place, over the size of what it lights, for a distant light in its stead.
NEAREST = 0.05


class Lamp(NamedTuple):
    """A light that stands somewhere, for `Scene.lamps`.

    kind: "point", "spot", "sphere", "rectangle" or "disk".
    pose: lamp to world, (4, 4); its last column is where the lamp stands. A spot, a rectangle and a disk shine along −z. A
        rectangle reaches from −1 to 1 along x and y; a disk has a radius of 1, and so has a sphere: the lengths of the columns
        x, y and z make them larger or smaller.
    strength: linear RGB, (3,): radiant intensity of a point or a spot, W/sr; radiance of what has an extent, W/(m² sr).
    cone: of a spot, the angles from −z at which it begins to dim and at which it ends, radians.
    """

    kind: Kind
    pose: Float[np.ndarray, "4 4"]
    strength: Float[np.ndarray, "3"]
    cone: tuple[float, float] = (0.0, 0.0)


def fault_of(lamp: Lamp, farthest: float, brightest: float) -> str:
    """What is wrong with it; empty if nothing is."""
    if lamp.kind not in get_args(Kind):
        return f"{lamp.kind!r} is no kind of lamp: {', '.join(get_args(Kind))}"
    pose, strength = np.asarray(lamp.pose), np.asarray(lamp.strength)
    if pose.shape != (4, 4) or not np.abs(pose).max() <= farthest or tuple(pose[3]) != (0, 0, 0, 1):
        return f"a {lamp.kind} takes a pose of 4 × 4 numbers, none beyond {farthest:g}, whose last row is 0 0 0 1"
    if strength.shape != (3,) or not ((strength >= 0) & (strength <= brightest)).all():
        return f"a {lamp.kind} takes a strength of three numbers from 0 to {brightest:g}, not {strength.tolist()}"
    if lamp.kind == "spot" and not (
        np.shape(lamp.cone) == (2,) and 0 <= lamp.cone[0] <= lamp.cone[1] <= np.pi and lamp.cone[1]
    ):
        return f"a spot takes a cone of two angles, in order and at most π, not {lamp.cone}"
    x, y, z = pose[:3, :3].T
    if lamp.kind == "spot" and not np.linalg.norm(z) > 0:
        return "a spot of no direction shines nowhere"
    if lamp.kind in ("rectangle", "disk") and not np.linalg.norm(np.cross(x, y)) > 0:
        return f"a {lamp.kind} of no size shines nowhere"
    if lamp.kind == "sphere" and not radius(lamp) > 0:
        return "a sphere of no size shines nowhere: make it a point"
    return ""


def facing(lamp: Lamp) -> Float[np.ndarray, "4 4"]:
    """The pose with z along n, of length 1, and x, y, z right-handed; of a spot all three of length 1."""
    x, y, z = lamp.pose[:3, :3].T
    out = np.eye(4)
    if lamp.kind == "spot":
        n = -z / np.linalg.norm(z)
        across = np.cross(n, np.eye(3)[np.abs(n).argmin()])
        x = across / np.linalg.norm(across)
        y = np.cross(n, x)
    else:
        n = np.cross(x, y) / np.linalg.norm(np.cross(x, y))
        if n @ z >= 0:
            y, n = -y, -n
    out[:3] = np.stack([x, y, n, lamp.pose[:3, 3]], axis=1)
    return out


def radius(lamp: Lamp) -> float:
    """Of a sphere: that of the ball with the volume of the ellipsoid."""
    return float(np.abs(np.linalg.det(np.asarray(lamp.pose)[:3, :3])) ** (1 / 3))


def area(lamp: Lamp) -> float:
    """Of a rectangle or a disk."""
    across = float(np.linalg.norm(np.cross(lamp.pose[:3, 0], lamp.pose[:3, 1])))
    return (4.0 if lamp.kind == "rectangle" else np.pi) * across


def as_distant(lamp: Lamp, places: Float[np.ndarray, "N 3"]) -> Distant:
    """The distant light whose E⊥, as a vector toward it, is the mean of the lamp's over some places."""
    way = lamp.pose[:3, 3] - places
    least = NEAREST * float(np.linalg.norm(np.ptp(places, axis=0)))
    d = np.maximum(np.linalg.norm(way, axis=1), max(least, 1e-12))
    toward = way / d[:, None]
    if lamp.kind == "point":
        share = 1 / d**2
    elif lamp.kind == "sphere":
        share = np.pi * radius(lamp) ** 2 / np.maximum(d, radius(lamp)) ** 2
    else:
        cosine = -toward @ facing(lamp)[:3, 2]
        if lamp.kind == "spot":
            begins, ends = lamp.cone
            share = np.interp(np.arccos(np.clip(cosine, -1, 1)), [begins, max(ends, begins + 1e-9)], [1.0, 0.0]) / d**2
        else:
            share = area(lamp) * np.maximum(cosine, 0.0) / (d**2 + area(lamp) / np.pi)
    mean = (share[:, None] * toward).mean(axis=0)
    length = float(np.linalg.norm(mean))
    direction = mean / length if length > 0 else np.array([0.0, 1.0, 0.0])
    return Distant(direction, length * np.asarray(lamp.strength, np.float64))
