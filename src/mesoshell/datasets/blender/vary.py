"""A picture of what each parameter of a recipe does by itself."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from mesoshell.datasets.blender.process import Blender
from mesoshell.errors import InputError
from mesoshell.io.image import read_exr
from mesoshell.io.sheet import over_grey, tile_pictures


def vary_sheet(
    blender: Blender, steps: int, index: int, show: Callable[[int, int], None]
) -> Float32[np.ndarray, "H W 3"]:
    """A row a parameter, from its least value to its greatest in even steps, the others fixed or at their defaults.
    Geometry, camera and light are those of sample `index`. Raises Crash, or InputError if an image cannot be rendered."""
    parameters = blender.manifest["parameters"]
    rest = {name: entry["default"] for name, entry in parameters.items()} | blender.manifest["fixed_parameters"]
    wanted = [
        (n, v) for n, entry in parameters.items() for v in np.linspace(entry["range"][0], entry["range"][1], steps)
    ]
    images = []
    with tempfile.TemporaryDirectory() as scratch:
        for done, (name, value) in enumerate(wanted):
            show(done, len(wanted))
            answer = blender.render(index, Path(scratch) / "image.exr", parameters={**rest, name: float(value)})
            if "fault" in answer:
                raise InputError(f"{name}={value:g}", answer["fault"])
            images.append(over_grey(read_exr(Path(scratch) / "image.exr")))
    return tile_pictures(np.stack(images), steps)
