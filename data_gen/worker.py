"""Entry point: a process that renders samples on request, one line in and one line out, until its input ends.

    python -m data_gen.worker '{"recipe": "grass", "seed": 0, "size": 128, ...}'

First it answers with {"manifest": ...}, or {"unusable": "one line"} and exit status 2.  Then, for every request
{"index": 7, "file": "/tmp/7.exr"}, with {"index": 7, "row": ..., "seconds": ..., "memory": MiB} once the file is there,
or {"index": 7, "fault": "one line"}.  A request may carry "parameters", "cycles_seed", "samples_per_pixel" or "denoise" of its
own; one
whose file is null renders nothing and is answered with the row.

Its parent's end closes its input, so it never outlives it by more than one image.  Without a request it stays out of
Blender: a manifest costs no import.

Notation
    E⊥        `irradiance` of a row: RGB, linear Rec. 709, on the plane that faces the light
    coverage  the box's side over the frame's width, at the distance of the box's centre
"""

import json
import math
import os
import resource
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from data_gen import carpet, fur, grass, sample, tiles
from data_gen.recipe import Recipe

SCHEMA = 1
RECIPES = {recipe.name: recipe for recipe in (grass.RECIPE, fur.RECIPE, *carpet.RECIPES)}
SMALLEST_COVERAGE, LARGEST_COVERAGE = 1e-3, 2.5


class UnusableInput(Exception):
    """The settings cannot be used; the message is one line."""


def recipe_of(settings: Mapping[str, Any]) -> Recipe:
    name = settings["recipe"]
    if name not in RECIPES:
        raise UnusableInput(f"no recipe named {name}; there are: {', '.join(sorted(RECIPES))}")
    return RECIPES[name]


def checked(recipe: Recipe, values: Mapping[str, float]) -> dict[str, float]:
    """Values of some parameters, each in its range."""
    for name, value in values.items():
        if name not in recipe.parameters:
            raise UnusableInput(f"{recipe.name} has no parameter {name}; it has {', '.join(recipe.parameters)}")
        low, high = recipe.parameters[name].range
        if not low <= value <= high:
            raise UnusableInput(f"parameter {name} must lie in {low:g} to {high:g}, not {value:g}")
    return dict(values)


def drawer_of(settings: Mapping[str, Any]) -> sample.Drawer:
    recipe = recipe_of(settings)
    low, high = settings["coverage"] or sample.default_coverage(settings["size"])
    if not (math.isfinite(low) and SMALLEST_COVERAGE <= low <= high <= LARGEST_COVERAGE):
        raise UnusableInput(f"coverage must rise within {SMALLEST_COVERAGE:g} to {LARGEST_COVERAGE:g}: {low} {high}")
    fixed = checked(recipe, settings["fixed"])
    shared = settings["patch"], settings.get("views"), settings.get("tiles", False)
    drawer = sample.Drawer(recipe, settings["seed"], (low, high), fixed, *shared)
    if drawer.tiles:
        try:
            drawer.grow(drawer.draw(0))
        except ValueError as fault:
            raise UnusableInput(f"{recipe.name} cannot be tiled: {fault}") from None
    return drawer


def manifest(drawer: sample.Drawer, settings: Mapping[str, Any]) -> dict:
    """What the dataset's manifest says of all its samples."""
    low, high = drawer.coverage
    size = settings["size"]
    return {
        "schema": SCHEMA,
        "recipe": drawer.recipe.name,
        "version": drawer.recipe.version,
        "alpha": "premultiplied",
        "colour": "linear Rec. 709, half float",
        "camera": "camera-to-world, looks along -z, y up, pixel centres at +0.5",
        "pixel_filter": "box, 1 pixel",
        "box": [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]],
        "field_of_view": sample.FIELD_OF_VIEW,
        "parameters": {name: parameter._asdict() for name, parameter in drawer.recipe.parameters.items()},
        "fixed_parameters": dict(drawer.fixed),
        "patch": drawer.patch,
        **({} if drawer.views is None else {"views": drawer.views}),
        **({"tiles": tiles.COLOURS} if drawer.tiles else {}),
        "coverage_range": [low, high],
        "radius_range": [sample.radius_of(high), sample.radius_of(low)],
        "size": [size, size],
        "samples_per_pixel": settings["samples_per_pixel"] or drawer.recipe.samples,
        "denoise": settings["denoise"],
        "seed": drawer.seed,
    }


def row(drawn: sample.Sample, size: int, irradiance: float) -> dict:
    """What the dataset's row says of one sample."""
    return {
        "seed": drawn.cycles_seed,
        "instance": drawn.instance,
        "size": [size, size],
        "parameters": drawn.parameters,
        "camera_to_world": drawn.camera_to_world.tolist(),
        "fov": sample.FIELD_OF_VIEW,
        "radius": drawn.radius,
        "light": drawn.light.tolist(),
        "irradiance": [irradiance] * 3,
    }


class Worker:
    """Answers requests; Blender is loaded at the first one."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.settings = settings
        self.drawer = drawer_of(settings)
        self.manifest = manifest(self.drawer, settings)
        self.studio: Any = None

    def answer(self, request: Mapping[str, Any]) -> dict:
        index = request["index"]
        drawn = self.drawer.draw(index)
        drawn = drawn._replace(parameters={**drawn.parameters, **request.get("parameters", {})})
        known = {"index": index, "row": row(drawn, self.settings["size"], self.drawer.recipe.irradiance)}
        if request["file"] is None:
            return known
        drawn = drawn._replace(cycles_seed=request.get("cycles_seed", drawn.cycles_seed))
        spp = request.get("samples_per_pixel", self.manifest["samples_per_pixel"])
        denoise = request.get("denoise", self.manifest["denoise"])
        try:
            seconds = self._studio().shoot(drawn, spp, denoise, Path(request["file"]))
        except (OSError, MemoryError) as fault:
            return {"index": index, "fault": str(fault) or "out of memory"}
        return {**known, "seconds": seconds, "memory": resident()}

    def _studio(self) -> Any:
        if self.studio is None:
            from data_gen.studio import Studio

            self.studio = Studio(self.drawer, self.settings["size"], self.settings["threads"])
        return self.studio


def resident() -> float:
    """The most memory that this process has held, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main() -> int:
    out = os.fdopen(os.dup(1), "w", buffering=1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)  # Blender writes to descriptor 1 from C, past sys.stdout
    try:
        worker = Worker(json.loads(sys.argv[1]))
    except UnusableInput as fault:
        out.write(json.dumps({"unusable": str(fault)}) + "\n")
        return 2
    out.write(json.dumps({"manifest": worker.manifest}) + "\n")
    for line in sys.stdin:
        out.write(json.dumps(worker.answer(json.loads(line))) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
