"""Fifty pictures in one process, of one scene and of scenes loaded anew, take no more memory than ten."""

import gc
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import pytest

from mesoshell.pathtracer.load import load_dict
from tests.helpers.path_traced import ROOT

SLACK = 32 * 2**20


def held() -> int:
    """Bytes of memory that the process holds."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def grass(depth: int) -> mi.Scene:
    view = mi.ScalarTransform4f().look_at([1.5, 0.9, -2.4], [0, 0.05, 0.15], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 32, "height": 32}
    turf = {"type": "mesoshell", "material": "grass"}
    spot = {"type": "obj", "filename": str(ROOT / "tests/data/spot.obj"), "bsdf": turf}
    return load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": depth},
            "sensor": {"type": "perspective", "fov": 40, "to_world": view, "film": film},
            "light": {"type": "constant"},
            "spot": spot,
        }
    )


def test_a_scene_is_let_go() -> None:
    """Nothing that a scene's integrator holds holds the scene."""
    made: Any = grass(4)
    context = weakref.ref(made.integrator().context)
    assert context() is not None
    del made
    gc.collect()
    assert context() is None


@pytest.mark.slow
@pytest.mark.parametrize("anew", [False, True])
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_fifty_pictures(anew) -> None:
    made = grass(4)
    scene: Callable = (lambda: grass(4)) if anew else (lambda: made)
    sizes = []
    for seed in range(50):
        mi.render(scene(), spp=4, seed=mi.UInt32(seed)).numpy()
        sizes.append(held())
    assert max(sizes[-5:]) - max(sizes[5:10]) < SLACK, sizes
