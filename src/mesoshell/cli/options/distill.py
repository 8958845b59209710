"""Options of `mesoshell distill`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Options:
    """Learn a surface material from a neural shell or from geometry: one query a hit. A run that was interrupted goes on."""

    #: A shell of one patch that repeats, or with --twin of corner tiles: grass, a .npz file or a folder; or geometry, for which
    #: mesoshell[mitsuba] is needed: weave, scales, spheres or fibres, or an image file with heights.
    material: tyro.conf.Positional[str]
    #: The surface material to write.
    out: Path | None = None
    #: Also distil a far-view level of detail into a copy of the shell's bundle, this file; `mesoshell render` uses it where its
    #: error is small enough. Instead of --out, or as well.
    twin: Path | None = None
    #: Folder of queries, checkpoints and log; OUT, or TWIN, without .npz if not given.
    run: Path | None = None
    #: NAME=VALUE of the shell's parameters; may be repeated. A surface material has none of its own.
    param: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    #: Height over the side of a patch, which becomes a period. Default: as the shell or the geometry was made, 0.12 for
    #: images.
    thickness: float | None = None
    #: Diffuse colour of the surface under a shell, linear R G B; it becomes part of the material. Default: bare earth.
    base: tuple[float, float, float] | None = None
    #: Least and greatest curvature, 1 / patch; positive is seen from outside. Default: -0.5 to 0.75 over the
    #: thickness for a shell, -0.5 0.5 for its twin, -1 2 for geometry.
    curvature: tuple[float, float] | None = None
    #: Number of cylinders, and of queries on each. Default: 4096 and 2048 for a shell, 1024 and 8192 for geometry.
    patches: int | None = None
    queries: int | None = None
    #: Light paths a query, for geometry. Default: 16.
    spp: int | None = None
    #: Thousands of queries to learn from; the preset's if not given.
    kimg: float | None = None
    #: tiny checks that everything works; mini takes 6000 steps, small 30 000: for geometry three and fifteen minutes on two
    #: cores, after six or more for the queries.
    preset: Literal["tiny", "mini", "small"] = "small"
