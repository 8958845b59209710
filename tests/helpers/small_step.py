"""A configuration that a test can compile, and a batch of random numbers for it."""

import jax
import numpy as np

from mesoshell.shell.generator.discriminator import DiscriminatorConfig
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.train.gan.generate import ImageBatch
from mesoshell.train.gan.state import GanConfig, sized_for
from mesoshell.train.patch_renderer import PictureConfig

CONFIG = sized_for(
    GanConfig(
        GeneratorConfig(16, "T", 32, 4, channels=4, layers=4, z=4, w=4, height_rows=8, height_width=4),
        DiscriminatorConfig(8, 64, 4, embedding=4),
        PictureConfig(8, 4, texels=16, height_rows=8, octaves=1),
        trunk=(4,),
        head=(4,),
        batch=8,
    ),
    appearance=1,
    geometry=1,
)


def batch() -> ImageBatch:
    rng = np.random.default_rng(0)
    eye = np.eye(4)[None].repeat(8, 0)
    eye[:, :3, 3] = [0.5, 0.5, 3.0] + 0.3 * rng.normal(size=(8, 3))
    light = np.array([[0.6, 0.0, 0.8]]).repeat(8, 0)
    image = rng.uniform(size=(8, 8, 8, 4))
    keys = np.asarray(jax.random.key_data(jax.random.split(jax.random.key(1), 8)))
    return ImageBatch(image, rng.uniform(size=(8, 1)), rng.uniform(size=(8, 1)), eye, light, np.full((8, 3), 5.0), keys)
