"""From many patches with geometry parameters (mesoshell fit): the generator's textures at new phases are told from them by a
critic, which knows the parameters. A window is one patch, since each wraps around by itself.

Its 245 000 rows took 395 s of an H200 (docs/results/generator.md): `carpet` was made so, and `fur` by 295 000.
"""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.textures.state import TexturesConfig, critic_config


def variant(preset: GanConfig) -> TexturesConfig:
    made = replace(critic_config(preset), batch=32, kimg=245.0, window=64, snapshot_kimg=16.0)
    return made if made.generator.channel_max >= 64 else replace(made, kimg=0.08)


config = variant(SMALL)
