"""Fewer samples where they count: python -m benchmarks.spacing [--size 96]

Five scenes on `spot.obj`, from the settings that `normal` had (48 samples a ray in proportion to length, heights filtered over
all of a sample's extent, every sample lit) to those that it has, one change at a time. FLIP against 36 rays a pixel of 160
samples in proportion to length, with heights filtered over 0.4; evaluations are density and transport queries a camera ray,
which no machine's noise moves; seconds are those of all stages, summed over threads, the least of three.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import mesoshell as ms
from benchmarks.light_samples import shown
from mesoshell.measure.flip import flip

#: What `normal` was on 2026-11-21, and until 2026-11-28.
RAYS: dict[str, Any] = {"pixel_samples": 4, "early_stop": 0.01, "footprint": 1.0, "anisotropy": 1}
BEFORE: dict[str, Any] = RAYS | {"samples": 48, "spacing": "length", "height_filter": 1.0, "light_samples": 0}
LATER: dict[str, Any] = RAYS | {"samples": 20, "light_samples": 6}
STEPS: dict[str, tuple[str, dict[str, Any]]] = {
    "as it was": ("normal", BEFORE),
    "half of the samples": ("normal", BEFORE | {"samples": 24}),
    "heights filtered over 0.4": ("normal", BEFORE | {"samples": 24, "height_filter": 0.4}),
    "by density": ("normal", LATER | {"samples": 24, "light_samples": 0}),
    "20 samples": ("normal", LATER | {"light_samples": 0}),
    "6 lit": ("normal", LATER),
    "`normal`": ("normal", {}),
    "draft as it was": ("draft", BEFORE | {"samples": 24, "pixel_samples": 1, "early_stop": 0.05}),
    "`draft`": ("draft", {}),
}
#: Material, patch, and the side of the picture relative to --size.
SCENES = {
    "grass": ("grass", 0.207, 1.0),
    "grass, small patches": ("grass", 0.05, 0.67),
    "lawn": ("lawn", 0.25, 1.0),
    "carpet": ("carpet", 0.25, 1.0),
    "turf": ("turf", 0.2, 1.0),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--out", type=Path, default=None, help="write the rows as JSON, too")
    options = parser.parse_args()
    rows = []
    print("| scene | settings | FLIP | mean colour | evaluations a ray | seconds |\n|---|---|---|---|---|---|")
    for name, (material, scale, share) in SCENES.items():
        side = round(share * options.size)
        scene = ms.Scene("src/mesoshell/assets/spot.obj", ms.load_material(material), scale=scale, size=(side, side))
        fine = ms.render(
            scene,
            "reference",
            pixel_samples=36,
            samples=160,
            coordinates="interpolated",
            filtering=True,
            footprint=1.0,
            anisotropy=1,
            visibility="interval",
            base_samples=8,
            twin=0.0,
        )
        for step, (quality, changes) in STEPS.items():
            row = {"scene": name, "settings": step} | measured(scene, quality, changes, fine)
            rows.append(row)
            print(
                f"| {name} | {step} | {row['flip']:.4f} | {row['colour']:+.1%} | {row['evaluations']:.1f} |"
                f" {row['seconds']:.2f} |",
                flush=True,
            )
    if options.out is not None:
        options.out.write_text(json.dumps(rows, indent=1) + "\n")


def measured(scene: ms.Scene, quality: str, changes: dict[str, Any], fine: ms.Picture) -> dict[str, float]:
    """FLIP, mean colour relative to the reference's, evaluations a camera ray and seconds."""
    pictures = [ms.render(scene, quality, **changes, twin=0.0) for _ in range(3)]
    counts = pictures[-1].report["counts"]
    queries = counts["density_queries"] + counts["transport_queries"]
    return {
        "flip": flip(shown(fine), shown(pictures[-1])),
        "colour": float(np.mean(pictures[-1].rgba[..., :3]) / np.mean(fine.rgba[..., :3]) - 1),
        "evaluations": queries / counts["rays"],
        "seconds": min(
            sum(s for k, s in p.report["seconds"].items() if k not in ("wall", "total", "setup", "prepare"))
            for p in pictures
        ),
    }


if __name__ == "__main__":
    main()
