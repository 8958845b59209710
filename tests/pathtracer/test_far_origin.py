"""A scene 65536 times its size from the origin has the picture that it has there, if floats hold its numbers at both places.

Origins of rays are Mitsuba's, float32 in world space: an event on a ray lies up to half the spacing of floats there away.
"""

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from mesoshell.pathtracer.load import load_dict
from tests.helpers.path_traced import QUALITY, scene, sensor, shell

#: Floats up to twice as far have a spacing of 2⁻⁷.
AWAY = np.array([2.0**16, -(2.0**16), 2.0**15])


def bent(folder: Path, away: np.ndarray, middle: float) -> Path:
    """A roof or a valley, of corners that floats hold with `away` added."""
    path = folder / f"bent{away[0]:g}.obj"
    points = np.array([[0, 0, 0], [0.5, 0, middle], [1, 0, 0], [0, 1, 0], [0.5, 1, middle], [1, 1, 0]]) + away
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
    lines += [f"vt {u} {v}" for u, v in ((0, 0), (0.5, 0), (1, 0), (0, 1), (0.5, 1), (1, 1))]
    path.write_text("\n".join([*lines, "f 1/1 2/2 5/5 4/4", "f 2/2 3/3 6/6 5/5", ""]))
    return path


def picture(
    materials: Path, away: np.ndarray, middle: float, depth: int, ground: float = 0.0, of: str = "rough"
) -> np.ndarray:
    eye, target = (np.array([0.5, -1.5, 2.5]) + away).tolist(), (np.array([0.5, 0.5, 0.5]) + away).tolist()
    view = sensor(to_world=mi.ScalarTransform4f().look_at(eye, target, [0, 0, 1]), near_clip=1e-4, far_clip=1e6)
    view["film"] = view["film"] | {"width": 32, "height": 32}
    view["sampler"] = {"type": "stratified", "sample_count": 64}
    roof = shell(materials, of, asked={"thickness": 0.25, "scale": 0.5})
    roof["filename"] = str(bent(materials, away, middle))
    roof["bsdf"]["inner"]["reflectance"] = {"type": "rgb", "value": ground}
    made = load_dict(scene(roof, eye=view, depth=depth), QUALITY.with_changes(samples=64, weight_cut=0.0))
    return np.array(mi.render(made, spp=64))


@pytest.mark.parametrize(("middle", "depth"), [(0.25, 2), (0.25, 4), (-0.25, 4)])
def test_a_picture_far_from_the_origin(materials, middle: float, depth: int) -> None:
    near, far = (picture(materials, away, middle, depth) for away in (0 * AWAY, AWAY))
    mean, off = near[..., :3].mean(), np.abs(far - near)
    assert mean > 1e-3 and 0.2 < near[..., 3].mean() < 0.95
    assert off[..., 3].max() < 1e-6
    assert off[..., :3].mean() < (1e-5 if middle > 0 else 1e-3) * mean


def test_ground_far_from_the_origin(materials) -> None:
    """Bright ground is shadowed by the shell that stands on it, and lights it."""
    near, far = (picture(materials, away, -0.25, 4, 0.8, "thin") for away in (0 * AWAY, AWAY))
    black = picture(materials, 0 * AWAY, -0.25, 4, of="thin")
    assert near[..., :3].mean() > 1.5 * black[..., :3].mean() > 1e-3
    assert abs(far[..., :3].mean() / near[..., :3].mean() - 1) < 0.02
