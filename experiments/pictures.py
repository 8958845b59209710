"""Pictures after textures: a generator and decoder that have learned fitted textures (`--transfer lawn.npz`) are taught further
through the renderer, at a low rate, judged by a discriminator, and by heads on the maps of a network that saw photographs.
"""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.textures.state import critic_config


def variant(preset: GanConfig) -> GanConfig:
    generator = replace(critic_config(preset).generator, precision="float32")
    # with 32 samples a ray, noise would be as strong as the finest detail, and hide it
    picture = replace(preset.picture, texels=generator.texels, height_rows=generator.height_rows, samples=64)
    return replace(
        preset,
        generator=generator,
        picture=picture,
        discriminator=replace(
            preset.discriminator,
            kind="vision-aided",
            opacity=True,
            channel_base=preset.discriminator.channel_base // 2,
            channel_max=preset.discriminator.channel_max // 2,
        ),
        # with a quarter of γ and twice the rate, heads ran away from a generator as slow as this; with four times pixel_gamma
        # the residual discriminator hardly told pictures from renders within 2200 images
        discriminator_rate=1e-3,
        gamma=16 * preset.gamma,
        trunk=(64, 64, 64),
        head=(64, 64),
        generator_rate=2e-4,
        near_kimg=0.0,  # its generator has learned from near and far already
    )


config = variant(SMALL)
