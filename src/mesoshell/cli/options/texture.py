"""Options of `mesoshell texture`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Options:
    """Make one texture with a material's generator. Rendering it needs no generator, and looks the same every time."""

    #: A bundled material's name, or a .npz file, with a generator in it.
    material: tyro.conf.Positional[str]
    #: A file NAME.npz; or a folder NAME, for textures larger than memory: its arrays are memory-mapped .npy files.
    out: Path
    #: Patches along u and v, whole or not.
    extent: tuple[float, float] = (4.0, 4.0)
    #: Texels a patch, the generator's own or a half, a quarter, ... of them: enough for what is seen from far away.
    texels: int | None = None
    #: Another seed, another texture.
    seed: int = 0
    #: Another SEED, and the SHARE, from 0 to 1, by which z goes from that of --seed toward that of SEED.
    latent: tuple[int, float] | None = None
    #: NAME=VALUE; may be repeated. Geometry is baked, and NAME=IMAGE varies it over the extent (grey; black to white spans
    #: its range); appearance becomes the default that a render can still change.
    param: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
