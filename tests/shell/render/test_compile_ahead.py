"""What is compiled ahead is what tiles call, and changes no picture."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mesoshell.render.effects import Effect
from mesoshell.render.quality import Quality
from mesoshell.shell.geometry import batched_walk
from mesoshell.shell.geometry.march import TOP
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.shell.material.loader import load_device_material
from mesoshell.shell.render import kernels, lighting, renderer, spacing
from mesoshell.shell.render.scene import Medium
from tests.helpers import scenes

ALWAYS: list[Any] = [batched_walk._advance, lighting._jacobians]
ALWAYS += [kernels.frames, kernels.density, kernels.transport, kernels.density_at]
PROGRAMS = {
    "density": [*ALWAYS, spacing.interval_segments, spacing.depth_profile, spacing.places],
    "length": [*ALWAYS, kernels.depth_bounds],
}
PROGRAMS["baked"] = [*PROGRAMS["density"], kernels.baked_depths]


@pytest.mark.parametrize(
    ("by", "several"),
    [
        pytest.param("density", False, marks=pytest.mark.slow),
        pytest.param("density", True, marks=pytest.mark.slow),
        pytest.param("length", False, marks=pytest.mark.slow),
        ("baked", True),
    ],
)
def test_tiles_compile_nothing_more(tiny_bundle, tiled_bundle, monkeypatch, by: str, several: bool) -> None:
    """Several tiles of a picture whose ground is seen through the shell, of which a half may be of another material."""
    scene = scenes.slab(tiny_bundle)
    if several:
        scene = replace(
            scene, others=(Medium(load_device_material(tiled_bundle), scene.alpha, {}, 1.0, prism=1, face=1),)
        )
    baked = by == "baked"
    quality = Quality(spacing="density" if baked else by, pixel_samples=1, light_samples=4 if baked else 0)
    plan = replace(scenes.effects(scene, quality), baked_density=Effect(baked, "for the test"))
    expected, _ = renderer.render(scene, quality, plan)
    for program in PROGRAMS[by]:
        program.clear_cache()
    monkeypatch.setattr(renderer, "RAYS", 64)
    ahead, compile_ = [], renderer._Renderer.compile

    def counted(self) -> None:
        compile_(self)
        ahead.extend(program._cache_size() for program in PROGRAMS[by])

    monkeypatch.setattr(renderer._Renderer, "compile", counted)
    image, report = renderer.render(scene, quality, plan)
    assert min(ahead) >= 1 and [program._cache_size() for program in PROGRAMS[by]] == ahead
    down = np.array([[0.3, 0.2, 1.0]]), np.array([[0.0, 0.0, -1.0]])
    start = batched_walk.Starts(*down, np.zeros(1, np.int32), np.full(1, TOP, np.int32))
    again, _ = batched_walk.visit(
        Boundary(scene.shell, scene.mesh.faces).prisms, start, exact=True
    )  # as of a doubtful ray
    assert len(again.intervals.ray) and [program._cache_size() for program in PROGRAMS[by]] == ahead
    asked = "intervals", "transport_queries", "grid_reads" if baked else "surface_queries"
    assert min(report.counts[name] for name in asked) > 0
    np.testing.assert_allclose(image, expected, atol=1e-6)
