"""Pictures after textures with twice the texels a patch. A generator of half as many lends its layers' weights (`--transfer
lawn.npz`): at first blades are half as wide as its own, and the pictures teach the rest, in the plane alone.
"""

from dataclasses import replace

from experiments.pictures import variant as pictures
from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig


def variant(preset: GanConfig) -> GanConfig:
    config = pictures(preset)
    made = config.generator
    finer = replace(made, texels=2 * made.texels, channel_base=2 * made.channel_base)
    picture = replace(config.picture, texels=finer.texels)
    # F(h) and the decoder, which all textures share, learn a bright outline over a dark ground first: an edge at half height
    return replace(config, generator=finer, picture=picture, taught="plane")


config = variant(SMALL)
