"""Whether budgets and errors are kept, in forty pictures: python -m benchmarks.goals FOLDER [--size 48] [--seconds 120]

Of marches, `spot.obj` with grass, `suzanne.obj` with fur and a slab of turf, from nearby and from afar, and a carpet in
close-up; of paths three scenes of experiments/scenes. Two budgets and two errors each. A budget is kept if the loop took 0.8 to
1.2 of it, an error if the picture's FLIP against the reference is at most as large; the reference's own, by noise, is in that.
References take so many seconds each; FOLDER keeps them, and every row of the table as JSON.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mesoshell as ms
from mesoshell.io.atomic import replace_file
from mesoshell.measure.flip import flip
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.scene.accumulate import Goal, over_backdrop
from mesoshell.scene.picture import Prepared
from mesoshell.scene.prepare import prepare
from mesoshell.scene.reach import picture_of
from mesoshell.scene.render_paths import prepare_file
from mesoshell.tradeoff.knobs import noise_of
from mesoshell.tradeoff.points import combined_error
from mesoshell.tradeoff.reference import render_reference

SPOT, SUZANNE, PLANE = "src/mesoshell/assets/spot.obj", "tests/data/suzanne.obj", "experiments/scenes/plane.obj"
#: Mesh, material, scale and camera.
MARCHED: dict[str, tuple[str, str, float | None, tuple[float, ...] | None]] = {
    "spot, grass, near": (SPOT, "grass", None, (1.5, 0.9, -2.4, 0, 0.05, 0.15, 40)),
    "spot, grass, far": (SPOT, "grass", None, (2.2, 1.4, -9, 0, 0.05, 0.15, 25)),
    "suzanne, pelt, near": (SUZANNE, "pelt", None, (-1.3, 2, 7.6, -2.49, 1.2, 4.1, 38)),
    "suzanne, pelt, far": (SUZANNE, "pelt", None, (-0.5, 3, 14, -2.49, 1.2, 4.1, 30)),
    "slab, turf, near": (PLANE, "turf", 0.2, (0.3, 0.35, 0.6, 0, 0, 0, 40)),
    "slab, turf, far": (PLANE, "turf", 0.05, (0, 0.5, 2, 0, 0, 0, 40)),
    "spot, carpet, close": (SPOT, "carpet", 0.25, (1.5, 0.9, -2.4, 0, 0.05, 0.15, 12)),
}
TRACED = ("spot.xml", "room.xml", "field.xml")
GOALS: tuple[dict[str, Any], ...] = ({"budget": 1.0}, {"budget": 4.0}, {"error": 0.05}, {"error": 0.03})
PATH_GOALS: tuple[dict[str, Any], ...] = ({"budget": 8.0}, {"budget": 24.0}, {"error": 0.1}, {"error": 0.06})
ON_TIME, AIM = (0.8, 1.2), 0.002
NORMAL, REFERENCE = PRESETS["normal"], PRESETS["reference"]
#: What only adds noise to paths.
KNOBS = ("spp", "light_samples", "early_stop")


class View(NamedTuple):
    """A view to render. paths: whether they are traced; side: in pixels."""

    name: str
    prepared: Prepared
    paths: bool
    side: int


def views(side: int) -> Iterator[View]:
    for name, (mesh, material, scale, camera) in MARCHED.items():
        scene = ms.Scene(mesh, ms.load_material(material), scale=scale, camera=camera, size=(side, side))
        yield View(name, prepare(scene, NORMAL), False, side)
    for name in TRACED:
        yield View(name, traced(name, side, NORMAL), True, side)


def traced(name: str, side: int, quality: Quality) -> Prepared:
    return prepare_file(Path("experiments/scenes") / name, quality, None, pixels=side * side)


def reference(view: View, seconds: float, folder: Path) -> tuple[np.ndarray, float]:
    """The folder's, or a new one: its picture and its noise."""
    file = folder / f"{view.name}, {view.side}, {seconds:g}.npz"
    if not file.exists():
        exact, prepared = REFERENCE, view.prepared
        if view.paths:
            exact = REFERENCE.with_changes(**noise_of(NORMAL, KNOBS))
            prepared = traced(view.name, view.side, exact)  # with all texels
        made = render_reference(prepared.passes(exact), not view.paths, seconds, AIM, lambda share: None)
        np.savez(file, image=made.image, noise=made.noise)
    with np.load(file) as held:
        return held["image"], float(held["noise"])


def reached(view: View, goal: dict[str, Any], true: np.ndarray) -> dict[str, Any]:
    """What was promised, what came of it, and whether it was kept."""
    picture = picture_of(view.prepared, NORMAL, Goal(**goal), True, lambda share: None)
    record = picture.report["goal"]
    error = flip(over_backdrop(picture.rgba), over_backdrop(true))
    ((what, value),) = goal.items()
    kept = error <= value if what == "error" else ON_TIME[0] <= record["seconds"] / value <= ON_TIME[1]
    row = {
        "view": view.name,
        "promised": what,
        "value": value,
        "seconds": record["seconds"],
        "flip": error,
        "kept": kept,
    }
    row |= {"noise": record["noise"], "bias": record.get("bias"), "samples": record["samples"]["mean"]}
    return row | {"settings": record.get("settings", {})}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--size", type=int, default=48, help="pixels of a side")
    parser.add_argument("--seconds", type=float, default=120.0, help="of each reference")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    columns = "view", "promised", "seconds", "FLIP estimated", "FLIP reached", "its own", "samples a pixel", "kept"
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    rows = []
    for view in views(given.size):
        true, noise = reference(view, given.seconds, given.folder)
        for goal in PATH_GOALS if view.paths else GOALS:
            row = reached(view, goal, true)
            rows.append(row | {"reference": noise})
            estimated = "" if row["noise"] is None else f"{combined_error(row['bias'] or 0.0, row['noise'], 1):.4f}"
            cells = [row["view"], f"{row['promised']} {row['value']:g}", f"{row['seconds']:.2f}", estimated]
            cells += [f"{row['flip']:.4f}", f"{noise:.4f}", f"{row['samples']:.1f}", "yes" if row["kept"] else "**no**"]
            print(f"| {' | '.join(cells)} |", flush=True)
        replace_file(given.folder / "goals.json", (json.dumps(rows, indent=1, default=str) + "\n").encode())
    for what in ("budget", "error"):
        own = [row for row in rows if row["promised"] == what]
        print(f"{what}: {sum(row['kept'] for row in own)} of {len(own)} kept")


if __name__ == "__main__":
    main()
