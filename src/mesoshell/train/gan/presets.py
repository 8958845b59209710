"""Sizes of training runs, from a test's to the paper's.

preset   pictures   texels a patch   generator's channels   for
tiny     16²        16               base 256, at most 16   tests: a step takes half a second on two cores
mini     32²        32               base 1024, at most 64  a CPU over an hour: 11 pictures a second on two cores
small    64²        64               base 4096, at most 64  a CPU over a day, or any GPU
base     128²       128              base 8192, at most 128 a GPU
paper    128²       256              base 32768, at most 512 8 GPUs over days (MesoGAN, section 5.1)

γ follows 0.5 at 128² and batch 32, in proportion to pixels over batch. Fourier maps have 16 sinusoids a channel, whose
phases drift: textures do not repeat (docs/results/generator.md).
"""

from mesoshell.shell.generator.discriminator import DiscriminatorConfig
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.patch_renderer import PictureConfig

TINY = GanConfig(
    generator=GeneratorConfig(
        texels=16,
        channel_base=256,
        channel_max=16,
        channels=8,
        layers=6,
        waves=16,
        drift=1.5,
        z=16,
        w=16,
        height_rows=16,
        height_width=16,
    ),
    discriminator=DiscriminatorConfig(size=16, channel_base=256, channel_max=16, embedding=16),
    picture=PictureConfig(size=16, samples=8, texels=16, height_rows=16),
    trunk=(16, 16),
    head=(16,),
    batch=4,
    kimg=0.24,
    near_kimg=0.1,
    snapshot_kimg=0.12,
    gamma=0.06,
)
MINI = GanConfig(
    generator=GeneratorConfig(
        texels=32, channel_base=1024, channel_max=64, layers=6, waves=16, drift=1.5, z=32, w=32, height_rows=32
    ),
    discriminator=DiscriminatorConfig(size=32, channel_base=2048, channel_max=128),
    picture=PictureConfig(size=32, samples=24, texels=32, height_rows=32),
    views=2,
    kimg=40.0,
    near_kimg=2.0,
    gamma=0.125,
    snapshot_kimg=4.0,
)
SMALL = GanConfig(generator=GeneratorConfig(waves=16, drift=1.5), views=2, near_kimg=1.5)
BASE = GanConfig(
    generator=GeneratorConfig(
        texels=128, channel_base=8192, channel_max=128, waves=16, drift=1.5, z=128, w=128, height_rows=128
    ),
    discriminator=DiscriminatorConfig(size=128, channel_base=16384, channel_max=256, embedding=128),
    picture=PictureConfig(size=128, samples=32, texels=128, height_rows=128),
    trunk=(64, 64),
    head=(64, 64),
    batch=16,
    kimg=5000.0,
    near_kimg=500.0,
    snapshot_kimg=50.0,
    gamma=1.0,
)
PAPER = GanConfig(
    generator=GeneratorConfig(
        texels=256, channel_base=32768, channel_max=512, waves=16, drift=1.5, z=512, w=512, height_rows=256
    ),
    discriminator=DiscriminatorConfig(size=128, channel_base=32768, channel_max=512, embedding=512),
    picture=PictureConfig(size=128, samples=64, texels=256, height_rows=256),
    trunk=(64, 64),
    head=(64, 64),
    batch=32,
    kimg=25_000.0,
    near_kimg=2000.0,
    snapshot_kimg=200.0,
    gamma=0.5,
)
PRESETS = {"tiny": TINY, "mini": MINI, "small": SMALL, "base": BASE, "paper": PAPER}
