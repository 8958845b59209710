"""Which settings lie on the front of several scenes at once: python -m benchmarks.presets FOLDER [--minutes 45] [--keep FILE]

Four scenes of marches and two of paths, small, or details of larger pictures. As `mesoshell tradeoff` does for one scene, it
measures the presets, each setting alone beside them, and what a model of the points so far expects most of, for so many
minutes; FOLDER keeps what was measured, and a later run goes on. Prints the front, and what each preset costs over the cheapest
settings of no more error. --keep writes all points as JSON: a test holds the presets to `benchmarks/presets.json`.

Notation
n           rays a pixel of marches; paths have 16 n
q           network queries a pixel and ray
x           1 for exact coordinates, else 0
c(S, n)     n (RAY + q (1 + TAP (taps − 1) + EXACT x)), with one tap unfiltered: what settings S cost in queries, which nothing
            else that the machine does moves; geometric mean of scenes
e(S, n)     FLIP, geometric mean of scenes
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mesoshell as ms
from mesoshell.io.atomic import replace_file
from mesoshell.render.effects import PATHS
from mesoshell.render.quality import PRESETS
from mesoshell.scene.choose import EXACT, RAY, TAP
from mesoshell.scene.picture import Prepared
from mesoshell.scene.prepare import prepare
from mesoshell.scene.render_paths import prepare_file
from mesoshell.tradeoff.front import Entry, entries, front
from mesoshell.tradeoff.knobs import describe_changes, noise_of, settings_of
from mesoshell.tradeoff.points import Point, Q, measure_point
from mesoshell.tradeoff.reference import Reference, render_reference
from mesoshell.tradeoff.search import propose, singles

SPOT, PLACES = "src/mesoshell/assets/spot.obj", Path("experiments/scenes")
#: Material, mesh, patch, camera, pixels of a side.
MARCHED: dict[str, tuple[str, str, float, tuple[float, ...] | None, int]] = {
    "grass": ("grass", SPOT, 0.207, None, 96),
    "field": ("turf", str(PLACES / "plane.obj"), 0.05, (0, 0.1, 0.5, 0, 0, 0, 40), 64),
    "carpet, a detail": ("carpet", SPOT, 0.25, (1.5, 0.9, -2.4, 0, 0.05, 0.15, 9), 56),
    "fur, a detail": ("pelt", SPOT, 0.12, (1.5, 0.9, -2.4, 0, 0.05, 0.15, 9), 56),
}
TRACED = {"spot": 48, "room": 48}
#: Seconds for each reference, and where its noise is low enough, FLIP; paths a pixel for a ray a pixel.
REFER, AIM, PATHS_A_RAY = 100.0, 0.001, 16
COUNTS = (1, 2, 4, 8)
#: Others change less than what is measured here (docs/how_to/tradeoff.md).
KNOBS = (
    "samples",
    "height_filter",
    "coordinates",
    "early_stop",
    "light_samples",
    "filtering",
    "footprint",
    "anisotropy",
)
#: Cost beyond which nothing is asked for.
DEAREST = 1000.0
#: With density from the network, as all of `presets.json` is.
NORMAL, REFERENCE = PRESETS["normal"].with_changes(density="network"), PRESETS["reference"]


class Place(NamedTuple):
    """A scene. paths: whether they are traced; used: knobs that its pictures depend on."""

    name: str
    prepared: Prepared
    paths: bool
    used: tuple[str, ...]
    reference: Reference

    def own(self, settings: dict[str, Any]) -> dict[str, Any]:
        return {name: settings[name] for name in self.used}


@dataclass
class Measured:
    """Points of each place so far, which the folder keeps."""

    folder: Path
    places: tuple[Place, ...]
    points: dict[str, list[Point]] = field(default_factory=dict)

    def of(self, place: Place, settings: dict[str, Any]) -> Point | None:
        return next((p for p in self.points.get(place.name, ()) if p.settings == place.own(settings)), None)

    def complete(self, settings: dict[str, Any]) -> bool:
        return all(self.of(place, settings) is not None for place in self.places)

    def measure(self, settings: dict[str, Any]) -> None:
        """What no place has yet."""
        for place in self.places:
            if self.of(place, settings) is None:
                own = place.own(settings)
                passes = place.prepared.passes(NORMAL.with_changes(**own))
                point, _ = measure_point(own, passes, place.reference, lambda share: None)
                self.points.setdefault(place.name, []).append(point)
        kept = {name: [p.as_dict() for p in points] for name, points in self.points.items()}
        replace_file(self.folder / "points.json", (json.dumps(kept, indent=1) + "\n").encode())

    def combine(self, settings: dict[str, Any]) -> Point:
        """One point for all places: c as seconds, e as flip."""
        each = [(place, p) for place in self.places if (p := self.of(place, settings)) is not None]

        def mean(of: Callable[[Place, Point], float]) -> float:
            return float(np.exp(np.mean([np.log(max(of(*one), 1e-6)) for one in each])))

        def count(place: Place, n: int) -> int:
            return n * PATHS_A_RAY if place.paths else n

        taps = settings["anisotropy"] if settings["filtering"] else 1
        query = 1 + TAP * (taps - 1) + EXACT * (settings["coordinates"] == "exact")
        cost = mean(lambda place, p: RAY + p.evaluations * query)
        flip = tuple(mean(lambda place, p, n=n: p.error(count(place, n))) for n in COUNTS)
        bias = mean(lambda place, p: max(p.bias, place.reference.noise))
        noise = mean(lambda place, p: p.noise / count(place, 1) ** (1 / Q))
        none = (0.0,) * len(COUNTS)
        queries = mean(lambda place, p: p.evaluations)
        return Point(settings, (cost,) * 3, 0.0, queries, COUNTS, flip, none, none, bias, noise, 0.0, 0.0)


def places(folder: Path) -> Iterator[Place]:
    for name, (material, mesh, scale, camera, side) in MARCHED.items():
        scene = ms.Scene(mesh, ms.load_material(material), scale=scale, camera=camera, size=(side, side))
        yield place(name, prepare(scene, NORMAL), folder)
    for name, side in TRACED.items():
        yield place(f"{name}, paths", prepare_file(PLACES / f"{name}.xml", REFERENCE, None, pixels=side * side), folder)


def place(name: str, prepared: Prepared, folder: Path) -> Place:
    """With its reference, the folder's or a new one."""
    paths, used = prepared.engine == PATHS.name, set()
    for preset in PRESETS.values():
        passes = prepared.passes(preset)
        used |= set(passes.ended(np.zeros((*passes.shape, 4)), 1).record["quality"])
    file = folder / f"{name}.npz"
    if not file.exists():
        exact = REFERENCE.with_changes(**noise_of(NORMAL, KNOBS)) if paths else REFERENCE
        made = render_reference(prepared.passes(exact), not paths, REFER, AIM, lambda share: None)
        np.savez(file, **made._asdict())
        print(f"{name}: reference of noise {made.noise:.4f}", flush=True)
    with np.load(file) as held:
        reference = Reference(held["image"], held["first"], *(held[name].item() for name in Reference._fields[2:]))
    return Place(name, prepared, paths, tuple(k for k in KNOBS if k in used), reference)


def kept(folder: Path) -> dict[str, list[Point]]:
    path = folder / "points.json"
    if not path.exists():
        return {}
    return {name: [Point.of(row) for row in rows] for name, rows in json.loads(path.read_text()).items()}


def search(found: Measured, minutes: float) -> list[Point]:
    """Measure until time is up; all points. Every second is one that the model proposes, once it has a dozen."""
    end = time.perf_counter() + 60 * minutes
    planned = [*(settings_of(p, KNOBS) for p in PRESETS.values()), *singles(KNOBS)]
    points = [found.combine(s) for s in unique([*planned, *of_all(found)]) if found.complete(s)]
    while time.perf_counter() < end:
        known = [p.settings for p in points]
        plan = next((s for s in planned if s not in known), None)
        model = (
            propose([p for p in points if p.seconds[1] < DEAREST])
            if len(points) >= 12 and (plan is None or len(points) % 2)
            else None
        )
        settings = plan if model is None or model in known else model
        if settings is None:
            break
        found.measure(settings)
        points.append(found.combine(settings))
        p = points[-1]
        print(f"{p.seconds[1]:6.1f} {p.flip[0]:.4f} {p.flip[2]:.4f}  {describe_changes(settings)}", flush=True)
    return points


def of_all(found: Measured) -> list[dict[str, Any]]:
    """Settings measured in a place that all knobs matter to."""
    whole = next(place.name for place in found.places if place.used == KNOBS)
    return [p.settings for p in found.points.get(whole, ())]


def unique(settings: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return list({describe_changes(s): s for s in settings}.values())


def keep(points: Sequence[Point], path: Path) -> None:
    rows = [
        {"settings": p.settings, "cost": round(p.seconds[1], 2), "queries": round(p.evaluations, 2)}
        | {"flip": [round(x, 5) for x in p.flip]}
        for p in sorted(points, key=lambda p: p.seconds[1])
    ]
    path.write_text(json.dumps({"counts": COUNTS, "points": rows}, indent=1) + "\n")


def report(points: Sequence[Point]) -> None:
    """The front and the presets."""

    def row(name: str, entry: Entry) -> str:
        cells = name, entry.samples, f"{entry.seconds:.0f}", f"{entry.flip:.4f}", describe_changes(entry.point.settings)
        return f"| {' | '.join(map(str, cells))} |"

    all_ = entries(points)
    print("| | rays a pixel | cost | FLIP | settings |\n|---|---|---|---|---|")
    for name, preset in PRESETS.items():
        point = next(p for p in points if p.settings == settings_of(preset, KNOBS))
        own = next(e for e in entries([point]) if e.samples == min(preset.pixel_samples, COUNTS[-1]))
        least = min(e.seconds for e in all_ if e.flip <= own.flip)
        print(row(f"`{name}`, {own.seconds / least:.2f} of the cheapest", own))
    for entry in front(all_):
        print(row("front", entry))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="for what is measured")
    parser.add_argument("--minutes", type=float, default=45.0, help="that settings are measured for")
    parser.add_argument("--keep", type=Path, help="write points and presets as JSON")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    found = Measured(asked.folder, tuple(places(asked.folder)), kept(asked.folder))
    points = search(found, asked.minutes)
    report(points)
    if asked.keep:
        keep(points, asked.keep)


if __name__ == "__main__":
    main()
