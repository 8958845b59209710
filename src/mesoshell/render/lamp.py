"""Lamps: lights that stand somewhere. Engine mitsuba has them as they are; for engine jax each is a distant light (NumPy only).

Notation
pose         lamp to world, columns x, y, z and where it stands, c. A spot, a rectangle and a disk shine along −z; a rectangle
             reaches from −1 to 1 along x and y; a disk has a radius of 1, and so has a sphere, if x, y and z are of length 1
n            unit direction in which it shines
I            radiant intensity of a point or a spot, RGB                                                W/sr
L            radiance of what has an extent, RGB                                                        W/(m² sr)
A            area of a rectangle, 4 |x × y|, or a disk, π |x × y|
E⊥           irradiance on the plane facing the lamp, at a place p a distance d away: I / d²; L π r² / d² of a sphere of radius
             r; L A cos θ / (d² + A / π) of a rectangle or a disk seen at an angle θ from n, exact on the axis of a disk
"""

from typing import Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Float

from mesoshell.render.light import Distant

Kind = Literal["point", "spot", "sphere", "rectangle", "disk"]
#: Those that a ray can meet.
EXTENDED = ("sphere", "rectangle", "disk")


class Lamp(NamedTuple):
    """strength: I or L; cone: of a spot, the angles from n at which it begins to dim and at which it ends, radians."""

    kind: Kind
    pose: Float[np.ndarray, "4 4"]
    strength: Float[np.ndarray, "3"]
    cone: tuple[float, float] = (0.0, 0.0)


def fault_of(lamp: Lamp, farthest: float, brightest: float) -> str:
    """What is wrong with it; empty if nothing is."""
    pose, strength = np.asarray(lamp.pose), np.asarray(lamp.strength)
    if lamp.kind not in get_args(Kind):
        return f"{lamp.kind!r} is no kind of lamp: {', '.join(get_args(Kind))}"
    if pose.shape != (4, 4) or not np.abs(pose).max() <= farthest:
        return f"a {lamp.kind} takes a pose of 4 × 4 numbers, none beyond {farthest:g}"
    if strength.shape != (3,) or not ((strength >= 0) & (strength <= brightest)).all():
        return f"a {lamp.kind} takes a strength of three numbers from 0 to {brightest:g}, not {strength.tolist()}"
    if (lamp.kind == "spot" and not 0 <= lamp.cone[0] <= lamp.cone[1] <= np.pi) or (
        lamp.kind == "spot" and not lamp.cone[1]
    ):
        return f"a spot takes a cone of two angles, in order and at most π, not {lamp.cone}"
    if lamp.kind in ("spot", "rectangle", "disk") and not np.linalg.norm(np.cross(pose[:3, 0], pose[:3, 1])) > 0:
        return f"a {lamp.kind} of no size shines nowhere"
    if lamp.kind == "sphere" and not radius(lamp) > 0:
        return "a sphere of no size shines nowhere: make it a point"
    return ""


def facing(lamp: Lamp) -> Float[np.ndarray, "4 4"]:
    """The pose with z along n, of length 1, and x, y, z right-handed."""
    x, y = lamp.pose[:3, 0], lamp.pose[:3, 1]
    across = np.cross(x, y)
    flip = -1.0 if across @ lamp.pose[:3, 2] > 0 else 1.0
    out = np.eye(4)
    out[:3] = np.stack([x, flip * y, flip * across / np.linalg.norm(across), lamp.pose[:3, 3]], axis=1)
    return out


def radius(lamp: Lamp) -> float:
    """Of a sphere: that of the ball with the volume of the ellipsoid."""
    return float(np.abs(np.linalg.det(lamp.pose[:3, :3])) ** (1 / 3))


def area(lamp: Lamp) -> float:
    """Of a rectangle or a disk."""
    across = float(np.linalg.norm(np.cross(lamp.pose[:3, 0], lamp.pose[:3, 1])))
    return (4.0 if lamp.kind == "rectangle" else np.pi) * across


def as_distant(lamp: Lamp, place: Float[np.ndarray, "3"]) -> Distant:
    """The distant light that is the lamp's at one place: its direction, and its E⊥ there."""
    way = lamp.pose[:3, 3] - place
    d = max(float(np.linalg.norm(way)), 1e-12)
    toward = way / d if np.linalg.norm(way) > 0 else np.array([0.0, 1.0, 0.0])
    if lamp.kind == "point":
        share = 1 / d**2
    elif lamp.kind == "sphere":
        share = np.pi * radius(lamp) ** 2 / max(d, radius(lamp)) ** 2
    else:
        cosine = float(-toward @ facing(lamp)[:3, 2])
        if lamp.kind == "spot":
            begins, ends = lamp.cone
            angle = float(np.arccos(np.clip(cosine, -1, 1)))
            share = float(np.interp(angle, [begins, max(ends, begins + 1e-9)], [1.0, 0.0])) / d**2
        else:
            share = area(lamp) * max(cosine, 0.0) / (d**2 + area(lamp) / np.pi)
    return Distant(toward, share * np.asarray(lamp.strength, np.float64))
