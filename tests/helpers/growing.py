"""A generator small enough to bake in a second, in a bundle with an appearance and a geometry parameter, or that of a run."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import jax
import pytest

from mesoshell.io.bundle import Bundle, Parameter, write_bundle
from mesoshell.io.dataset import Dataset
from mesoshell.shell.generator import bake
from mesoshell.shell.generator.discriminator import DiscriminatorConfig
from mesoshell.shell.generator.generator import init_averages
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.train.export import generator_bundle
from mesoshell.train.gan.state import GanConfig, Learner, sized_for, start
from mesoshell.train.patch_renderer import PictureConfig
from mesoshell.train.run_config import keep_record
from mesoshell.typing import Array, Key

TEXELS = 16
PARAMETERS = (
    Parameter("age", "alpha", (0.0, 10.0), 2.0, "days", "how dry"),
    Parameter("length", "beta", (1.0, 3.0), 2.0, "cm", "length of a blade"),
)


CONFIG = GanConfig(
    GeneratorConfig(TEXELS, "T", 64, 4, channels=4, layers=4, z=4, w=4, height_rows=8, height_width=4),
    DiscriminatorConfig(8, 64, 4, embedding=4),
    PictureConfig(8, 4, texels=TEXELS, height_rows=8, octaves=1),
    trunk=(8,),
    head=(8,),
    batch=4,
)


@cache
def bundle() -> Bundle:
    return _begun(sized_for(CONFIG, appearance=1, geometry=1), 0)


def write_run(data: Dataset, folder: Path, *images: int) -> None:
    """A run as it would stand in its folder after so many images, but that nothing was learned. data: of one appearance
    parameter, age."""
    config = sized_for(CONFIG, appearance=1, geometry=0)
    keep_record(config, data, folder)
    (folder / "snapshots").mkdir()
    for count in images:
        write_bundle(folder / "snapshots" / f"{count:09d}.npz", _begun(config, count))


def _begun(config: GanConfig, images: int) -> Bundle:
    # in one program, and without what only training has: step by step it is hundreds
    learner = _start(config)(jax.random.key(3))
    declared = PARAMETERS[: 1 + config.generator.betas]
    return generator_bundle(config, learner, init_averages(config.generator), declared, {"images": images})


@cache
def _start(config: GanConfig) -> Callable[[Key[Array, ""]], Learner]:
    return jax.jit(lambda key: start(config, key).learner)


def without_grids(patch: pytest.MonkeyPatch) -> None:
    """As long as the patch holds, a texture is made without bounds of its density, which take longest to compile."""
    patch.setattr(bake, "_grids", lambda *_: bake.Share(0.0, 0.0))
