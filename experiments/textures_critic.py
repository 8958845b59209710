"""From corner tiles (a fitted material): the generator's textures at new phases are told from windows of them by a critic.

Its 58 000 rows took 400 s of an H200 (docs/results/generator.md).
"""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.textures.state import TexturesConfig, critic_config


def variant(preset: GanConfig) -> TexturesConfig:
    made = replace(critic_config(preset), batch=8, kimg=58.0, snapshot_kimg=4.0)
    return made if made.generator.channel_max >= 64 else replace(made, window=64, kimg=0.04)


config = variant(SMALL)
