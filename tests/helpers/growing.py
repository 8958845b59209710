"""A generator small enough to bake in a second, in a bundle with an appearance and a geometry parameter."""

from functools import cache

import jax

from mesoshell.io.bundle import Bundle, Parameter
from mesoshell.shell.generator.discriminator import DiscriminatorConfig
from mesoshell.shell.generator.generator import init_averages
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.train.export import generator_bundle
from mesoshell.train.gan.state import TrainConfig, sized, start
from mesoshell.train.patch_renderer import PictureConfig

TEXELS = 16
PARAMETERS = (
    Parameter("age", "alpha", (0.0, 10.0), 2.0, "days", "how dry"),
    Parameter("length", "beta", (1.0, 3.0), 2.0, "cm", "length of a blade"),
)


@cache
def bundle() -> Bundle:
    config = sized(
        TrainConfig(
            GeneratorConfig(TEXELS, "T", 64, 4, channels=4, layers=4, z=4, w=4, height_rows=8, height_width=4),
            DiscriminatorConfig(8, 64, 4, embedding=4),
            PictureConfig(8, 4, texels=TEXELS, height_rows=8, octaves=1),
            trunk=(8,),
            head=(8,),
        ),
        appearance=1,
        geometry=1,
    )
    # in one program, and without what only training has: step by step it is hundreds
    learner = jax.jit(lambda key: start(config, key).learner)(jax.random.key(3))
    return generator_bundle(config, learner, init_averages(config.generator), PARAMETERS, {"images": 0})
