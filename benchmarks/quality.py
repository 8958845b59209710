"""Error against seconds of the march's knobs: python -m benchmarks.quality

One view of the bundled mesh at 128 × 128, one ray a pixel. Reference: 2048 samples in float64 (`benchmarks/reference.py`).
Error: root mean square of the difference of x / (1 + x) and alpha, over pixels that the shell covers.
"""

import time

import numpy as np

from benchmarks import reference
from benchmarks.scenes import spot
from mesoshell.render.effects import plan_effects
from mesoshell.render.quality import Quality
from mesoshell.scene.render_shell import facts
from mesoshell.shell.render.renderer import render

REFERENCE = Quality(
    pixel_samples=1,
    samples=2048,
    spacing="length",
    coordinates="exact",
    early_stop=0.0,
    skip=0.0,
    weight_cut=0.0,
    light_samples=0,
)
SIZE = 128


def picture(scene, quality: Quality) -> tuple[np.ndarray, float]:
    effects = plan_effects(facts(scene), quality)
    render(scene, quality, effects)
    begin = time.perf_counter()
    image, _ = render(scene, quality, effects)
    seconds = time.perf_counter() - begin
    return tonemapped(image), seconds


def tonemapped(image: np.ndarray) -> np.ndarray:
    rgb = np.maximum(image[..., :3], 0)
    return np.concatenate([rgb / (1 + rgb), image[..., 3:]], axis=-1)


def main() -> None:
    scene = spot(SIZE)
    truth = tonemapped(reference.picture(scene, REFERENCE, plan_effects(facts(scene), REFERENCE)))
    single, _ = picture(scene, REFERENCE)
    covered = truth[..., 3] > 0
    print(f"2048 samples in float32: error {np.sqrt(np.mean((single - truth)[covered] ** 2)):.1e}\n")
    print("| coordinates | spacing | samples | early stop | error | seconds |\n|---|---|---|---|---|---|")
    plans = [(c, "length", n, 0.01) for n in (8, 16, 32, 64, 128, 256) for c in ("interpolated", "exact")]
    plans += [("interpolated", way, n, 0.01) for way in ("interval", "density") for n in (16, 64, 256)]
    plans += [("interpolated", "length", 64, stop) for stop in (0.0, 0.03, 0.1)]
    for coordinates, spacing, samples, stop in plans:
        quality = REFERENCE.with_changes(
            samples=samples, coordinates=coordinates, spacing=spacing, early_stop=stop, skip=0.05, weight_cut=0.048
        )
        found, seconds = picture(scene, quality)
        error = float(np.sqrt(np.mean((found - truth)[covered] ** 2)))
        print(f"| {coordinates} | {spacing} | {samples} | {stop} | {error:.4f} | {seconds:.2f} |")


if __name__ == "__main__":
    main()
