"""`mesoshell atlas capture`: photographs of a mesh, by Blender."""

import numpy as np

from mesoshell.cli.checks import at_least
from mesoshell.cli.options.atlas import Capture
from mesoshell.cli.progress import bar, stderr
from mesoshell.datasets.blender.photograph import PhotographConfig, photograph
from mesoshell.errors import InputError
from mesoshell.geometry.mesh import load_mesh
from mesoshell.io.atomic import probe_folder
from mesoshell.io.image import read_picture
from mesoshell.limits import check_memory
from mesoshell.scene.setup import axis_of_file


def run(options: Capture) -> None:
    """All of `mesoshell atlas capture`."""
    at_least(options, views=2, size=8, spp=1, points=1, seed=0)
    if not (np.isfinite(options.noise) and options.noise >= 0):
        raise InputError("--noise", f"must be finite and not negative, not {options.noise}")
    check_memory("--size", f"pictures of {options.size} x {options.size}", 64 * options.size**2)
    check_memory("--points", f"{options.points} points", 64 * options.points)
    check_memory("--views", f"{options.views} photographs", 16 * options.views * options.size**2)
    probe_folder(options.out, "--out")
    if options.paint:
        read_picture(options.paint)
    up = axis_of_file(options.mesh)
    config = PhotographConfig(
        options.views,
        options.size,
        options.spp,
        options.paint,
        options.flash,
        up,
        options.points,
        options.noise,
        options.seed,
    )
    with bar(stderr(), "photographing", options.views, count=True) as show:
        photograph(load_mesh(options.mesh), config, options.out, show)
    print(f"{options.out}: {options.views} photographs of {options.size} x {options.size}")
