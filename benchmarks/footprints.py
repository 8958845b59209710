"""What the width of the texture's filter costs in accuracy, by rays a pixel: python -m benchmarks.footprints FOLDER

FLIP of the four marches of benchmarks.presets and of one from afar, against unfiltered references that FOLDER keeps, less the
noise of these. Settings are `normal`'s, and finer ones that leave little other bias and light all samples, so that density is
not baked. A width takes no queries; without a filter there are no taps. Where density may not be baked, its row is that of 0.5.
"""

import argparse
from pathlib import Path
from typing import Any

import mesoshell as ms
from benchmarks.ladder import taken
from benchmarks.presets import MARCHED, NORMAL, SPOT, place
from mesoshell.measure.flip import POWER
from mesoshell.scene.prepare import prepare

SETTINGS: dict[str, dict[str, Any]] = {
    "normal": {},
    "finer": {"samples": 80, "coordinates": "exact", "light_samples": 0, "anisotropy": 4},
}
WIDTHS: dict[str, dict[str, Any]] = {
    "1": {"footprint": 1.0},
    "0.5": {"footprint": 0.5},
    "0.25": {"footprint": 0.25},
    "none": {"filtering": False},
    "none, baked": {"density": "baked"},
}
AFAR = {"grass, afar": ("grass", SPOT, None, (2.2, 1.4, -9, 0, 0.05, 0.15, 25), 48)}
RAYS = (1, 3, 9, 17)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of benchmarks.presets")
    folder = parser.parse_args().folder
    print(f"| scene | settings | footprint | {' | '.join(map(str, RAYS))} |\n{'|---' * (3 + len(RAYS))}|")
    for name, (material, mesh, scale, camera, side) in (MARCHED | AFAR).items():
        scene = ms.Scene(mesh, ms.load_material(material), scale=scale, camera=camera, size=(side, side))
        here = place(name, prepare(scene, NORMAL), folder)
        for what, settings in SETTINGS.items():
            for width, change in WIDTHS.items():
                if "density" in change and settings:
                    continue
                found = taken(here.prepared.passes(NORMAL.with_changes(**settings, **change)), here.reference).errors
                counts = [n for n in RAYS if n in found]  # fewer on a slow machine
                less = [max(found[n] ** POWER - here.reference.noise**POWER, 0) ** (1 / POWER) for n in counts]
                print(f"| {name} | {what} | {width} | {' | '.join(f'{x:.3f}' for x in less)} |", flush=True)


if __name__ == "__main__":
    main()
