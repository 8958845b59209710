"""What filtering does to fields seen from afar, with a material's correction and without: python -m benchmarks.filtering

A field of 33 × 33 patches along the ground, with the light behind the camera and against it, from nearby (a texel of `turf` a
pixel) and from above. The same samples a ray, filtered over a pixel and not; without a filter many rays average what is seen,
and no features. light: radiance of the filtered picture over the unfiltered one's; apart: rms of what differs between blocks of
8 × 8 pixels, over the mean. The last column is seconds of `normal` without set-up, the least of three in turns, over those
without a correction.
"""

import argparse
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

import mesoshell as ms
from mesoshell.io.material import bundled_materials

ALONG = 0.0, 0.045, 0.5, 0.0, 0.005, 0.2, 50.0
VIEWS = {
    "along, light behind": (ALONG, (0.3, 0.5, 0.8)),
    "along, against the light": (ALONG, (0.6, 0.4, -0.5)),
    "from nearby": ((0.0, 0.07, 0.05, 0.0, 0.015, 0.0, 15.0), (0.6, 0.6, 0.5)),
    "from above": ((0.0, 0.5, 0.6, 0.0, 0.0, 0.0, 50.0), (0.6, 0.6, 0.5)),
}
#: Of both pictures that are compared; rays a pixel with filtering, and without.
SAMPLES, FILTERED, UNFILTERED, BLOCK = 100, 4, 24, 8


def field(material: ms.Material, view: str, side: int) -> ms.Scene:
    camera, light = VIEWS[view]
    seed = None if material.shell.generator is None and material.shell.tiles is None else 7
    return ms.Scene(
        "experiments/scenes/plane.obj",
        material,
        scale=0.03,
        seed=seed,
        camera=camera,
        size=(side, side),
        lights=[light],
    )


def blocks(scene: ms.Scene, **changes: Any) -> Float[np.ndarray, "h w 3"]:
    """Means of blocks of pixels, as linear light."""
    rgb = ms.render(scene, "normal", samples=SAMPLES, light_samples=0, footprint=1.0, **changes).rgba[..., :3]
    side = len(rgb) // BLOCK
    return rgb.reshape(side, BLOCK, side, BLOCK, 3).mean(axis=(1, 3))


def seconds(scenes: list[ms.Scene]) -> list[float]:
    """Of `normal`, the least of three after one that compiles."""
    taken = np.full((4, len(scenes)), np.inf)
    for k in range(4):
        for i, scene in enumerate(scenes):
            spent = ms.render(scene, "normal").report["seconds"]
            taken[k, i] = spent["total"] - spent["setup"]
    return taken[1:].min(axis=0).tolist()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("materials", nargs="*", default=sorted(bundled_materials()))
    parser.add_argument("--size", type=int, default=96)
    options = parser.parse_args()
    if options.size % BLOCK:
        parser.error(f"--size must be a multiple of {BLOCK}")
    print("| material | view | light, plain | corrected | apart, plain | corrected | time of the correction |")
    print("|---|---|---|---|---|---|---|")
    for name in options.materials:
        corrected = ms.load_material(name)
        if "correction" not in corrected.shell.arrays:
            parser.error(f"{name} has no correction: mesoshell prefilter {name} --out FILE")
        arrays = {key: array for key, array in corrected.shell.arrays.items() if key != "correction"}
        plain = ms.Material(name, replace(corrected.shell, arrays=arrays))
        for view in VIEWS:
            scenes = [field(material, view, options.size) for material in (plain, corrected)]
            true = blocks(scenes[0], filtering=False, pixel_samples=UNFILTERED)
            found = [blocks(scene, pixel_samples=FILTERED) for scene in scenes]
            light = [float(x.mean() / true.mean()) for x in found]
            apart = [float(np.sqrt(((x - true) ** 2).mean()) / true.mean()) for x in found]
            before, after = seconds(scenes)
            gaps = f"{light[0]:.2f} | {light[1]:.2f} | {apart[0]:.0%} | {apart[1]:.0%}"
            print(f"| {name} | {view} | {gaps} | {after / before:.2f} |", flush=True)


if __name__ == "__main__":
    main()
