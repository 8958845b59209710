"""Entry point: render a recipe's training images into a dataset folder.

    python -m data_gen.render grass --count 1200 --size 64 --spp 64 --out data/grass64 --seed 1

Alphabet
    E⊥        `irradiance` of a row: RGB, linear Rec. 709, on the plane that faces the light
    coverage  the box's side over the frame's width, at the distance of the box's centre

Exit status: 0 when every image asked for exists; 2, with one line that names the fault, on unusable input or a
folder that cannot be written; 130 when interrupted, after the image in hand.  A coverage above 2.5 would put the
camera inside the box.
An interrupted run is continued by the same command; a longer one by a larger --count.
"""

import argparse
import signal
import sys
import threading
from pathlib import Path
from typing import NamedTuple, NoReturn, TextIO

from data_gen import grass, sample
from data_gen.dataset import Dataset, UnusableInput
from data_gen.progress import Progress, take_standard_output
from data_gen.recipe import Recipe

SCHEMA = 1
INTERRUPTED = 130
RECIPES = {recipe.name: recipe for recipe in (grass.RECIPE,)}
SMALLEST_COVERAGE, LARGEST_COVERAGE = 1e-3, 2.5


class Work(NamedTuple):
    """What the images of one run share. `out` takes the progress lines."""

    options: argparse.Namespace
    drawer: sample.Drawer
    dataset: Dataset
    out: TextIO


class OneLineParser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise UnusableInput(message)


def parser() -> argparse.ArgumentParser:
    p = OneLineParser(prog="data_gen.render", description="Render training images of a mesostructure in Blender.")
    p.add_argument("recipe", help=f"what to render: {', '.join(RECIPES)}")
    p.add_argument("--count", type=int, required=True, help="number of images to have after this run, from --start on")
    p.add_argument("--size", type=int, default=128, help="side of the square image, pixels (default %(default)s)")
    p.add_argument("--spp", type=int, default=64, help="light paths a pixel (default %(default)s)")
    p.add_argument("--out", type=Path, required=True, help="dataset folder; made if missing, continued if it matches")
    p.add_argument("--seed", type=int, default=0, help="seed of cameras, lights and parameters (default %(default)s)")
    p.add_argument("--start", type=int, default=0, help="index of the first image (default %(default)s)")
    p.add_argument("--threads", type=int, default=0, help="CPU threads; 0 uses every core (default %(default)s)")
    p.add_argument(
        "--coverage",
        type=float,
        nargs=2,
        metavar=("MIN", "MAX"),
        help="range of the box's side over the frame's width: 2 2 has only the nearest cameras "
        f"(default: {sample.SMALLEST_BOX_PIXELS:g} pixels to {sample.LARGEST_COVERAGE:g})",
    )
    p.add_argument(
        "--param",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="fix a parameter instead of drawing it; may be repeated",
    )
    return p


def check(options: argparse.Namespace) -> None:
    """Raises `UnusableInput` on the first option out of its range."""
    if options.recipe not in RECIPES:
        raise UnusableInput(f"no recipe named {options.recipe}; there are: {', '.join(RECIPES)}")
    for name, least in (("count", 1), ("size", 1), ("spp", 1), ("start", 0), ("threads", 0), ("seed", 0)):
        if getattr(options, name) < least:
            raise UnusableInput(f"--{name} must be at least {least}, not {getattr(options, name)}")
    if options.coverage is None:
        options.coverage = sample.default_coverage(options.size)
    low, high = options.coverage
    if not SMALLEST_COVERAGE <= low <= high <= LARGEST_COVERAGE:
        raise UnusableInput(f"--coverage must rise within {SMALLEST_COVERAGE:g} to {LARGEST_COVERAGE:g}: {low} {high}")


def fixed_parameters(recipe: Recipe, assignments: list[str]) -> dict[str, float]:
    fixed = {}
    for assignment in assignments:
        name, _, text = assignment.partition("=")
        if name not in recipe.parameters:
            raise UnusableInput(f"--param {assignment}: {recipe.name} has {', '.join(recipe.parameters)}")
        low, high = recipe.parameters[name].range
        try:
            value = float(text)
        except ValueError:
            raise UnusableInput(f"--param {assignment}: not a number") from None
        if not low <= value <= high:
            raise UnusableInput(f"--param {assignment}: must lie in {low:g} to {high:g}")
        fixed[name] = value
    return fixed


def manifest(drawer: sample.Drawer, size: int, samples_per_pixel: int) -> dict:
    low, high = drawer.coverage
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
        "coverage_range": [low, high],
        "radius_range": [sample.radius_of(high), sample.radius_of(low)],
        "size": [size, size],
        "samples_per_pixel": samples_per_pixel,
        "seed": drawer.seed,
    }


def row(drawn: sample.Sample, size: int, irradiance: float) -> dict:
    return {
        "seed": drawn.cycles_seed,
        "size": [size, size],
        "parameters": drawn.parameters,
        "camera_to_world": drawn.camera_to_world.tolist(),
        "fov": sample.FIELD_OF_VIEW,
        "radius": drawn.radius,
        "light": drawn.light.tolist(),
        "irradiance": [irradiance] * 3,
    }


def run(options: argparse.Namespace) -> int:
    check(options)
    recipe = RECIPES[options.recipe]
    fixed = fixed_parameters(recipe, options.param)
    drawer = sample.Drawer(recipe, options.seed, tuple(options.coverage), fixed)
    indices = range(options.start, options.start + options.count)
    dataset = Dataset(options.out, manifest(drawer, options.size, options.spp), indices.stop)
    missing = [index for index in indices if index not in dataset.done]
    out = take_standard_output()
    out.write(f"{options.out}: {len(indices) - len(missing)} images exist, {len(missing)} to render\n")
    return shoot_all(Work(options, drawer, dataset, out), missing) if missing else 0


def shoot_all(work: Work, indices: list[int]) -> int:
    """Render the samples in turn.  Returns the exit status."""
    from data_gen import studio

    stop = asked_to_stop()
    progress = Progress(len(indices), work.out)
    camera = studio.Studio(work.drawer.recipe, work.options.size, work.options.spp, work.options.threads)
    for index in indices:
        drawn = work.drawer.draw(index)
        camera.shoot(drawn, work.dataset.partial(index))
        work.dataset.finish(index, row(drawn, work.options.size, studio.SUN))
        progress.step()
        if stop.is_set():
            return INTERRUPTED
    return 0


def asked_to_stop() -> threading.Event:
    """Set on an interrupt.  An exception would end an image halfway inside Blender, which saves it all the same."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    return stop


def main() -> int:
    try:
        return run(parser().parse_args())
    except (UnusableInput, OSError) as fault:
        print(f"data_gen.render: {fault}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
