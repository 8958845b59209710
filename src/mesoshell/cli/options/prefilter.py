"""Options of `mesoshell prefilter`."""

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Options:
    """Correct a material for distant views: filtered pixels then show the mean of what close views show.

    Fits the correction to the material's own unfiltered rays; needs no images; takes three to six minutes on two cores. Drops
    a twin: distil it again.
    """

    #: A bundled material's name, or a .npz file: a patch, corner tiles, or a generator.
    material: tyro.conf.Positional[str]
    #: The corrected material to write, NAME.npz; it may be the file itself.
    out: Path
    #: Steps for each level of the texture.
    steps: int = 300
    #: Seed of the training views and rays.
    seed: int = 0
