"""What a march's settings bias and how noisy they are: python -m benchmarks.ladder FOLDER [--picture FILE]

Measures each rung of mesoshell.scene.choose on the four marches of benchmarks.presets, whose references FOLDER keeps, and
prints the numbers of LADDER: geometric means of bias and noise over the noise of the first rung, and of its queries; PAIR; and
how far scenes lie apart. A bias that is not above the noise of the reference is unknown and left out. With --picture: the
strip of docs/how_to/time_and_error. Whether goals are reached: benchmarks.goals.

Notation
b, ν, q     as in mesoshell.scene.choose
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

import mesoshell as ms
from benchmarks.presets import MARCHED, NORMAL, SPOT, place
from mesoshell.io.atomic import replace_file
from mesoshell.io.image import write_png
from mesoshell.measure.flip import flip
from mesoshell.scene.accumulate import over_backdrop
from mesoshell.scene.choose import LADDER
from mesoshell.scene.prepare import prepare
from mesoshell.tradeoff.knobs import named
from mesoshell.tradeoff.points import Point, measured

#: How far above the noise of the reference a bias is known.
KNOWN = 1.1
CLOSE, SHOWN, BUDGETS = (1.5, 0.9, -2.4, 0, 0.05, 0.15, 40), 256, (1.0, 4.0, 16.0, 60.0)


def measure(folder: Path) -> tuple[dict[str, list[Point]], dict[str, float]]:
    """Points of each place, a rung each, and FLIP of one pass of the first rung against two."""
    points: dict[str, list[Point]] = {}
    pairs = {}
    for name, (material, mesh, scale, camera, side) in MARCHED.items():
        scene = ms.Scene(mesh, ms.load_material(material), scale=scale, camera=camera, size=(side, side))
        here = place(name, prepare(scene, NORMAL), folder)
        for rung in LADDER:
            passes = here.prepared.passes(NORMAL.with_changes(**rung.settings))
            point, images = measured(dict(rung.settings), passes, here.reference, lambda share: None)
            known = point.bias > KNOWN * here.reference.noise
            points.setdefault(name, []).append(replace(point, bias=point.bias if known else np.nan))
            if rung is LADDER[0]:
                pairs[name] = flip(over_backdrop(images[0]), over_backdrop(images[1]))
            print(
                f"{name:20} {point.evaluations:7.1f} {point.bias:.4f} {point.noise:.4f}  {named(rung.settings)}",
                flush=True,
            )
    return points, pairs


def report(points: dict[str, list[Point]], pairs: dict[str, float]) -> None:
    print("\n| settings | bias | noise | queries | bias of each scene |\n|---|---|---|---|---|")
    for k, rung in enumerate(LADDER):
        first, own = [p[0] for p in points.values()], [p[k] for p in points.values()]
        bias, noise, queries = (
            np.array([getattr(a, key) / getattr(b, of) for a, b in zip(own, first, strict=True)])
            for key, of in (("bias", "noise"), ("noise", "noise"), ("evaluations", "evaluations"))
        )
        cells = [
            named(rung.settings),
            *(f"{np.exp(np.nanmean(np.log(np.maximum(x, 1e-4)))):.3f}" for x in (bias, noise, queries)),
        ]
        print(f"| {' | '.join([*cells, ', '.join(f'{x:.2f}' for x in bias)])} |")
    shares = [pairs[name] / p[0].noise for name, p in points.items()]
    print(f"PAIR {np.exp(np.log(shares).mean()):.3f} ({', '.join(f'{x:.2f}' for x in shares)})")


def picture(path: Path) -> None:
    """The same view after each budget, written as a strip."""
    shown = ms.Scene(SPOT, ms.load_material("grass"), size=(SHOWN, SHOWN), camera=CLOSE)
    views = [ms.render(shown, budget=seconds) for seconds in BUDGETS]
    for view in views:
        print(view.report["goal"])
    write_png(path, np.concatenate([view.rgba for view in views], axis=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--picture", type=Path, help="write a strip of pictures")
    given = parser.parse_args()
    if given.picture:
        picture(given.picture)
        return
    given.folder.mkdir(parents=True, exist_ok=True)
    points, pairs = measure(given.folder)
    kept = {
        "pairs": pairs,
        "points": {
            name: [p.as_dict() | {"bias": None if np.isnan(p.bias) else p.bias} for p in some]
            for name, some in points.items()
        },
    }
    replace_file(given.folder / "ladder.json", (json.dumps(kept, indent=1) + "\n").encode())
    report(points, pairs)


if __name__ == "__main__":
    main()
