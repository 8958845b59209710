"""Light from few samples of a ray: python -m benchmarks.light_samples [--size 128]

`spot.obj` with grass at `normal`, under distant lights and under a sky, with `light_samples` 0 (all) to 1 and other numbers
of drawn directions. Seconds are those of all stages that grow with the rays, summed over threads. An error by noise falls as
one over the root of the rays, so what a setting takes to the error of the first row is its seconds times the square of its
error over that one's.
"""

import argparse
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

import mesoshell as ms
from mesoshell.measure.flip import flip

#: Rays a pixel; of the picture that others are measured against; turns, the first of which compiles.
RAYS, TRUE, TURNS = 4, 64, 4
TRIED = {
    "three distant lights": [{"light_samples": k} for k in (0, 8, 6, 4, 2, 1)],
    "a sky": [{"environment_samples": e, "light_samples": k} for e in (4, 8, 16) for k in (0, 6, 2)],
}


def sky() -> Float[np.ndarray, "64 128 3"]:
    """A blue sky, a dark ground and a small sun."""
    row = np.arange(64)[:, None]
    picture = np.stack(np.broadcast_arrays(0.4 + row / 160, 0.6 + row / 320, 1.0, np.zeros((1, 128)))[:3], axis=-1)
    picture[40:] = 0.15
    picture[14:17, 30:34] = 60.0
    return picture.astype(np.float32)


def shown(picture: ms.Picture) -> Float[np.ndarray, "H W 3"]:
    """Over black, as sRGB."""
    x = np.clip(picture.rgba[..., :3], 0, 1)
    return np.where(x < 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=128)
    side = parser.parse_args().size
    plain = ms.Scene(
        "src/mesoshell/assets/spot.obj", ms.load_material("grass"), thickness=0.06, scale=0.25, size=(side, side)
    )
    scenes = {"three distant lights": plain, "a sky": replace(plain, environment=sky())}
    print(
        "| scene | directions | light_samples | seconds | lit samples × lights a ray | FLIP | time to the first one's |"
    )
    print("|---|---|---|---|---|---|---|")
    for name, settings in TRIED.items():
        true = shown(ms.render(scenes[name], "normal", pixel_samples=TRUE, environment_samples=6, light_samples=0))
        rows = [measured(scenes[name], changes, true) for changes in settings]
        for changes, (seconds, asked, error) in zip(settings, rows, strict=True):
            directions, drawn = changes.get("environment_samples", "–"), changes["light_samples"] or "all"
            ratio = seconds / rows[0][0] * (error / rows[0][2]) ** 2
            print(f"| {name} | {directions} | {drawn} | {seconds:.1f} | {asked:.1f} | {error:.4f} | {ratio:.2f} |")


def measured(scene: ms.Scene, changes: dict[str, Any], true: np.ndarray) -> tuple[float, float, float]:
    """Seconds, evaluations a ray, and FLIP."""
    seconds, picture = [], None
    for _ in range(TURNS):
        picture = ms.render(scene, "normal", pixel_samples=RAYS, **changes)
        stages = picture.report["seconds"]
        seconds.append(sum(s for stage, s in stages.items() if stage not in ("wall", "total", "setup", "prepare")))
    assert picture is not None
    counts = picture.report["counts"]
    return float(np.median(seconds[1:])), counts["transport_queries"] / counts["rays"], flip(shown(picture), true)


if __name__ == "__main__":
    main()
