"""What a march's settings cost and bias, and whether goals are reached: python -m benchmarks.ladder [--goals | --picture FILE]

Prints, for `spot.obj` with grass from nearby and from afar, each rung of mesoshell.scene.choose and preset: seconds a pass,
median of PASSES, and relative to the first rung; density queries a ray; FLIP of the picture against that of `reference` at the
same rays, which is bias; and FLIP of one ray a pixel against PASSES, which is noise. With --goals: budgets and errors promised
and reached, where the error is against `reference` at more rays. With --picture: the strip of docs/how_to/time_and_error.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import mesoshell as ms
from mesoshell.io.image import write_png
from mesoshell.measure.flip import flip
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.scene.accumulate import over_backdrop
from mesoshell.scene.choose import LADDER
from mesoshell.scene.picture import Prepared
from mesoshell.scene.prepare import prepare

SIDE, PASSES, TRUE = 96, 4, 12
CAMERAS = {"near": None, "far": (2.2, 1.4, -9, 0, 0.05, 0.15, 25)}
CLOSE, SHOWN, BUDGETS = (1.5, 0.9, -2.4, 0, 0.05, 0.15, 40), 256, (1.0, 4.0, 16.0, 60.0)
GOALS = ({"budget": 1.0}, {"budget": 3.0}, {"budget": 10.0}, {"error": 0.05}, {"error": 0.03}, {"error": 0.02})
NORMAL, REFERENCE = PRESETS["normal"], PRESETS["reference"]


def scene(camera: tuple | None) -> ms.Scene:
    mesh = "src/mesoshell/assets/spot.obj"
    return ms.Scene(mesh, ms.load_material("grass"), size=(SIDE, SIDE), camera=camera)


def passes(ready: Prepared, quality: Quality, count: int) -> tuple[np.ndarray, list[float], float]:
    """Pictures of each pass, their seconds, and density queries a ray."""
    begun, pixels = ready.passes(quality), np.arange(SIDE * SIDE)
    begun.render(0, pixels, lambda share: None)  # compiles
    before = begun.ended(np.zeros((SIDE, SIDE, 4)), 1).record["counts"]["density_queries"]
    images, seconds = [], []
    for k in range(count):
        begin = time.perf_counter()
        images.append(begun.render(k, pixels, lambda share: None).reshape(SIDE, SIDE, 4))
        seconds.append(time.perf_counter() - begin)
    queries = begun.ended(images[0], count).record["counts"]["density_queries"] - before
    return np.array(images), seconds, queries / count / SIDE**2


def different(a: np.ndarray, b: np.ndarray) -> float:
    return flip(over_backdrop(a), over_backdrop(b))


def named(settings: dict[str, object]) -> str:
    return ", ".join(f"{k} {v}" for k, v in settings.items())


def rungs() -> None:
    print("| view | settings | s a pass | relative | queries a ray | bias | noise |\n|---|---|---|---|---|---|---|")
    for view, camera in CAMERAS.items():
        ready, first = prepare(scene(camera), NORMAL), 0.0
        true = passes(ready, REFERENCE, PASSES)[0].mean(axis=0)
        changed = [(named(rung.settings), NORMAL.with_changes(**rung.settings)) for rung in LADDER]
        for name, quality in (*changed, *((f"`{name}`", preset) for name, preset in PRESETS.items())):
            images, seconds, queries = passes(ready, quality, PASSES)
            median, mean = float(np.median(seconds)), images.mean(axis=0)
            first = first or median
            found = f"{different(mean, true):.4f} | {different(images[0], mean):.4f}"
            print(f"| {view} | {name} | {median:.3f} | {median / first:.1f} | {queries:.1f} | {found} |", flush=True)


def goals() -> None:
    print(
        "| view | promised | seconds | FLIP estimated | FLIP reached | rays a pixel | settings |\n|---|---|---|---|---|---|---|"
    )
    for view, camera in CAMERAS.items():
        shown = scene(camera)
        true = passes(prepare(shown, NORMAL), REFERENCE, TRUE)[0].mean(axis=0)
        for goal in GOALS:
            picture = ms.render(shown, **goal)
            reached = picture.report["goal"]
            name, value = next(iter(goal.items()))
            estimated = np.hypot(reached["noise"] or np.nan, reached["bias"])
            settings = named(reached["settings"])
            row = [view, f"{name} {value:g}", f"{reached['seconds']:.2f}", f"{estimated:.4f}"]
            row += [f"{different(picture.rgba, true):.4f}", f"{reached['samples']['mean']:.1f}", settings]
            print(f"| {' | '.join(row)} |", flush=True)


def picture(path: Path) -> None:
    """The same view after each budget, written as a strip."""
    shown = replace(scene(None), size=(SHOWN, SHOWN), camera=CLOSE)
    views = [ms.render(shown, budget=seconds) for seconds in BUDGETS]
    for view in views:
        print(view.report["goal"])
    write_png(path, np.concatenate([view.rgba for view in views], axis=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--goals", action="store_true", help="promised and reached")
    parser.add_argument("--picture", type=Path, help="write a strip of pictures")
    asked = parser.parse_args()
    if asked.picture:
        picture(asked.picture)
    else:
        (goals if asked.goals else rungs)()


if __name__ == "__main__":
    main()
