"""From many patches with geometry parameters (mesoshell fit): the generator's textures at new phases are told from them by a
critic, which knows the parameters. A window is one patch, since each wraps around by itself.

Its 245 000 rows took 395 s of an H200 (docs/results/generator.md).
"""

from dataclasses import replace

from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.textures.state import TexturesConfig, textures_as

GENERATOR = GeneratorConfig(
    layers=10, channel_base=6144, channel_max=96, waves=8, drift=1.5, z=0, texels=64, precision="bfloat16"
)


def variant(preset: TrainConfig) -> TexturesConfig:
    some = textures_as(preset).generator
    texels, most = min(64, some.texels), 3 * some.channel_max // 2
    generator = replace(GENERATOR, texels=texels, channel_base=texels * most, channel_max=most)
    made = replace(config, generator=generator, critic=replace(config.critic, width=most))
    return made if most >= 64 else replace(made, kimg=0.08)


config = TexturesConfig(GENERATOR, batch=32, kimg=245.0, rate=2.5e-3, adversarial=True, window=64, snapshot_kimg=16.0)
