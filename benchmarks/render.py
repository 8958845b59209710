"""A whole 512 × 512 render against its floor: python -m benchmarks.render [--size 512] [--reference FILE]

The floor is the least time that this machine could need for the work that was done, each rate probed in the same run:

    operations / matrix rate    multiply-adds of every decoder evaluation
    bytes / bandwidth           the texture rows and the numbers of a grid that every lookup gathers, once
    rays / Embree's rate        every ray that Embree was given: camera, re-entry and shadow rays

Compilation happens before the clock starts. With --reference, FLIP against 16 rays a pixel of 96 samples by the network,
unfiltered, which FILE keeps: over a grey of 0.5, its noise in it.
"""

import argparse
from pathlib import Path

import numpy as np

from benchmarks.rates import bandwidth, embree_rate, matrix_rate
from benchmarks.scenes import spot
from mesoshell.measure.flip import flip
from mesoshell.render.camera import pixel_grid, rays
from mesoshell.render.effects import plan_effects
from mesoshell.render.quality import PRESETS
from mesoshell.scene.render_shell import facts
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.shell.render.renderer import render


def work(scene, counts: dict[str, int]) -> tuple[float, float]:
    """Floating-point operations and bytes gathered of a render."""
    decoder = scene.device_material.material.decoder
    trunk = 2 * sum(x.kernel.size for x in [*decoder.trunk, decoder.sigma])
    head = 2 * sum(x.kernel.size for x in [*decoder.head, decoder.rho])
    row = scene.device_material.material.texture.rows
    gathered, read = 8 * row.shape[1] * row.dtype.itemsize, counts.get("grid_reads", 0) * 8 * 2
    queries = counts["density_queries"] + counts.get("surface_queries", 0)
    return queries * trunk + counts.get("transport_queries", 0) * head, queries * gathered + read


def shown(picture: np.ndarray) -> np.ndarray:
    return np.clip(picture[..., :3] + (1 - picture[..., 3:]) * 0.5, 0, 1)


def true_picture(scene, file: Path) -> np.ndarray:
    if not file.exists():
        exact = PRESETS["reference"].with_changes(pixel_samples=16, samples=96, weight_cut=0.001)
        np.save(file, render(scene, exact, plan_effects(facts(scene), exact))[0])
    return np.load(file)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--reference", type=Path, help="a .npy file, made if it is not there")
    asked = parser.parse_args()
    size = asked.size
    scene = spot(size)
    true = None if asked.reference is None else true_picture(scene, asked.reference)
    if true is not None and len(true) != size:
        parser.error(f"{asked.reference}: is of {len(true)} pixels a side, not of {size}")
    print(
        "| quality | seconds | floor | time / floor | trace | sample | decode | transport | light | surfaces | FLIP |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    before = {"density": "network", "spacing": "length", "height_filter": 1.0, "light_samples": 0, "footprint": 1.0}
    settings = {
        "draft": PRESETS["draft"],
        "draft as it was": PRESETS["draft"].with_changes(**before, samples=24),
        "normal": PRESETS["normal"],
        "normal, density by the network": PRESETS["normal"].with_changes(density="network"),
        "normal as it was": PRESETS["normal"].with_changes(
            **before, samples=48, pixel_samples=4, anisotropy=1, early_stop=0.01
        ),
    }
    for name, quality in settings.items():
        effects = plan_effects(facts(scene), quality)
        render(scene, quality, effects)
        picture, report = render(scene, quality, effects)
        c, s = report.counts, report.seconds
        operations, gathered = work(scene, c)
        o, d = rays(scene.camera, pixel_grid(scene.camera, 1, 0))
        embree = embree_rate(Boundary(scene.shell, scene.mesh.faces), o, d)
        traced = c["rays"] + c["visits"] + c.get("shadow_rays", 0)
        floor = operations / matrix_rate() + gathered / bandwidth() + traced / embree
        total = s["wall"]
        stages = " | ".join(
            f"{s.get(k, 0):.2f}" for k in ("trace", "sample", "decode", "transport", "light", "surfaces")
        )
        error = "" if true is None else f"{flip(shown(picture), shown(true)):.4f}"
        print(f"| {name} | {total:.2f} | {floor:.2f} | {total / floor:.1f} | {stages} | {error} |")
        heavy = c.get("heavy_samples", 0)
        print(f"\n{name}: {c}\nqueries / (3 × samples of weight > 1e-3 + rays): {queries_ratio(c, heavy):.2f}\n")


def queries_ratio(c: dict[str, int], heavy: int) -> float:
    """At most 1 where the renderer keeps its promise on density queries."""
    return c["density_queries"] / (3 * heavy + c["visits"])


if __name__ == "__main__":
    main()
