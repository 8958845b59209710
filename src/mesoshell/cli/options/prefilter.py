"""Options of `mesoshell prefilter`."""

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Options:
    """Correct a material for views from afar: what is averaged over a pixel shall show the mean of what near views show.

    It learns from the material's own unfiltered rays, and needs no images: three to six minutes on two cores. A twin is
    left out: distil it anew.
    """

    #: A bundled material's name, or a .npz file: a patch, corner tiles, or a generator.
    material: tyro.conf.Positional[str]
    #: The corrected material to write, NAME.npz; it may be the file itself.
    out: Path
    #: Steps for each level of the texture.
    steps: int = 300
    #: Of the views and rays that it learns from.
    seed: int = 0
