"""The work of `mesoshell atlas capture`."""

import numpy as np
from rich.console import Console
from rich.progress import Progress

from mesoshell.cli.options.atlas import Capture
from mesoshell.errors import InputError
from mesoshell.farm.photograph import Shooting
from mesoshell.farm.photograph import photograph as shoot
from mesoshell.geometry.mesh import load_mesh
from mesoshell.io.image import read_picture
from mesoshell.io.whole import probe_folder
from mesoshell.limits import check_memory


def photograph(options: Capture) -> None:
    """All of it."""
    for name, value, least in (
        ("--views", options.views, 2),
        ("--size", options.size, 8),
        ("--spp", options.spp, 1),
        ("--points", options.points, 1),
        ("--seed", options.seed, 0),
    ):
        if value < least:
            raise InputError(name, f"must be at least {least}, not {value}")
    if not (np.isfinite(options.noise) and options.noise >= 0):
        raise InputError("--noise", f"must be finite and not negative, not {options.noise}")
    check_memory("--size", f"pictures of {options.size} x {options.size}", 64 * options.size**2)
    check_memory("--points", f"{options.points} points", 64 * options.points)
    check_memory("--views", f"{options.views} photographs", 16 * options.views * options.size**2)
    probe_folder(options.out, "--out")
    if options.paint:
        read_picture(options.paint)
    up = 2 if options.mesh.suffix.lower() in (".ply", ".stl") else 1
    shooting = Shooting(
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
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("photographing", total=options.views)
        shoot(load_mesh(options.mesh), shooting, options.out, lambda n: bar.update(task, completed=n))
    print(f"{options.out}: {options.views} photographs of {options.size} x {options.size}")
