"""`mesoshell distill`: a surface material that looks like a neural shell, for one query a hit."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Options:
    """Learn a surface material from a neural shell: queries are marched through it on cylinders, then fitted. What was done
    is kept in a folder, and a run that was interrupted goes on."""

    #: A bundled shell's name, or a .npz file, with its texture.
    material: tyro.conf.Positional[str]
    #: The bundle to write.
    out: Path
    #: A further file: the shell's bundle with the surface material in it, of which `mesoshell render` takes the latter where
    #: footprints are so wide that it is as good.
    twin: Path | None = None
    #: Folder of queries, checkpoints and log; OUT without .npz if not given.
    run: Path | None = None
    #: NAME=VALUE of the shell's parameters; may be repeated. A surface material has none of its own.
    param: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    #: Height of the shell over the side of a patch, which becomes a period.
    thickness: float = 0.5
    #: Diffuse colour of the surface under the shell, linear R G B; it becomes part of the material.
    base: tuple[float, float, float] = (0.09, 0.06, 0.035)
    #: Least and greatest curvature, 1 / patch; positive is seen from outside.
    curvature: tuple[float, float] = (-1.0, 1.5)
    #: Number of cylinders, and of queries on each.
    patches: int = 160
    queries: int = 65536
    #: Thousands of queries to learn from; the preset's if not given.
    kimg: float | None = None
    #: tiny shows that all works; mini takes a fifth of small's steps; small is half an hour on two cores.
    preset: Literal["tiny", "mini", "small"] = "small"


def run(options: Annotated[Options, tyro.conf.arg(name="")]) -> None:
    """Learn a surface material from a neural shell: one query a hit in the place of a march."""
    from mesoshell.cli import distilling

    distilling.distill(options)
