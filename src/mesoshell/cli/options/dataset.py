"""Options of `mesoshell dataset`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Recipe:
    """What is rendered, and how."""

    #: The recipe: grass, fur, carpet, or carpet2, carpet4, carpet6, carpet8 with that many parameters.
    recipe: tyro.conf.Positional[str]
    #: Side of the square images in pixels.
    size: int = 128
    #: Seed of geometry, cameras, lights and parameters.
    seed: int = 0
    #: Fix a parameter: NAME=VALUE; may be repeated.
    param: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()


@dataclass(frozen=True, kw_only=True)
class Render(Recipe):
    """Render training images with Blender; a run that was interrupted goes on where it stopped."""

    #: Folder to write; made if missing, continued if it holds the same dataset.
    out: Path
    #: Number of images.
    count: int | None = None
    #: Light paths a pixel; the recipe's own default if not given (see `dataset cost`).
    spp: int | None = None
    #: Denoise the images.
    denoise: bool = False
    #: Show one periodic patch, of this seed, in every image (what `fit` needs); otherwise every image has new geometry.
    patch: int | None = None
    #: Instead of --count: number of periodic patches, each with a geometry and geometry parameters of its own.
    patches: int | None = None
    #: Images of each of the --patches, one patch after the other: more patches can be added later.
    views: int | None = None
    #: Show the 16 corner tiles in turn, each among its neighbours: a fit of these covers any area without repeating itself.
    tiles: bool = False
    #: Least and greatest side of the box over the width of the frame; from 8 pixels to 2 widths if not given.
    coverage: tuple[float, float] | None = None
    #: Blender processes on this machine; one a core if not given.
    workers: int | None = None
    #: Address of a Dask scheduler whose workers share the folder; instead of processes on this machine.
    scheduler: str | None = None


@dataclass(frozen=True)
class RenderPatches:
    """Trace queries of a mesostructure on cylinders of random curvature (what surface materials are trained on);
    a run that was interrupted goes on where it stopped. Needs mesoshell[mitsuba]."""

    #: weave, scales, spheres or fibres, or an image file with heights (8 or 16 bits, or OpenEXR).
    source: tyro.conf.Positional[str]
    #: Folder to write; made if missing, continued if it holds the same dataset.
    out: Path
    #: Number of patches.
    patches: int = 2400
    #: Queries a patch.
    queries: int = 65536
    #: Light paths a query.
    spp: int = 16
    #: Depth of the mesostructure over the side of its period; its own if not given (0.12 for images).
    depth: float | None = None
    #: Least and greatest curvature, 1 / period; positive is seen from outside.
    curvature: tuple[float, float] = (-1.0, 2.0)
    #: Seed of curvatures and queries.
    seed: int = 0


@dataclass(frozen=True)
class Vary(Recipe):
    """Write a sheet of what each parameter does: one a row, from its least to its greatest, the others at default."""

    #: The picture to write.
    out: Path = Path("parameters.png")
    #: Light paths a pixel.
    spp: int = 64
    #: Images a row.
    steps: int = 6
    #: Sample whose geometry, camera and light are shown.
    index: int = 0


@dataclass(frozen=True)
class Cost(Recipe):
    """Render one sample at 1 to 1024 light paths a pixel, with and without denoising, and compare it with 4096."""

    #: Sample to render.
    index: int = 0
    #: Side of the box over the width of the frame.
    coverage: float = 1.0
    #: Write the table here too, as JSON.
    out: Path | None = None


@dataclass(frozen=True)
class Check:
    """Look for every fault of a dataset, packed or not; exit status 1 if there is one."""

    #: Dataset folder.
    folder: tyro.conf.Positional[Path]


@dataclass(frozen=True)
class Pack:
    """Write a dataset as memory-mapped arrays, for training; smaller images are means over whole pixels."""

    #: Dataset folder.
    folder: tyro.conf.Positional[Path]
    #: Folder to write; must not exist.
    out: Path
    #: Side of the packed images in pixels, a divisor of the dataset's own; the same if not given.
    size: int | None = None


@dataclass(frozen=True)
class Sheet:
    """Write a contact sheet: many of a dataset's images side by side."""

    #: Dataset folder.
    folder: tyro.conf.Positional[Path]
    #: The picture to write.
    out: Path = Path("sheet.png")
    #: Order of the images: a parameter, or "radius"; by index if not given.
    sort: str | None = None
    #: Number of images, evenly spaced in that order.
    count: int = 96
    #: Images a row.
    columns: int = 12


@dataclass(frozen=True)
class Options:
    """Make, check, pack and look at datasets of training images."""

    command: Annotated[Render | RenderPatches | Check | Pack | Sheet | Vary | Cost, tyro.conf.arg(name="")]
