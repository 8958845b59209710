"""MesoGAN, figure 4: from Fourier maps to features to a material, for two seeds: python -m experiments.figures.mesogan_4

The first three channels of the map at the generator's input and of the texture that comes of it; the material from above and
from the side. 2 × 2 patches of the bundled lawn.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import mesoshell as ms
from experiments.figures.sheet import draw, over_white
from mesoshell.io.image import linear_to_srgb
from mesoshell.shell.generator.generator import synthesise
from mesoshell.shell.generator.model import GeneratorModel, generator_model, grown
from mesoshell.shell.generator.plan import CELL, frequencies_of, rows_of
from mesoshell.signal.fourier import fourier_map
from mesoshell.train.gan.snapshot import as_colours

MATERIAL, PATCHES, SIDE = "lawn", 2, 256
ABOVE, ASIDE = (0.0, 1.5, 0.001, 0.0, 0.0, 0.0, 38.0), (0.3, 0.55, 2.0, 0.0, 0.17, 0.0, 38.0)


def inputs(maker: GeneratorModel, seed: int) -> Float[np.ndarray, "V U C"]:
    """The map at the generator's input."""
    config, row = maker.config, rows_of(maker.config)[0]
    f, rate = frequencies_of(config), int(row.in_sampling_rate)
    phases = grown(maker, seed, np.zeros(config.betas, np.float32)).phases.input
    size, start = (PATCHES * rate, PATCHES * rate), jnp.zeros(2, jnp.int32)
    made = fourier_map(jnp.asarray(f.input), jnp.asarray(f.slow), phases, start, size, rate, config.waves, config.drift)
    return np.asarray(made[0])


def texture(maker: GeneratorModel, seed: int) -> Float[np.ndarray, "V U C"]:
    """The features that come of it."""
    config = maker.config
    latent, side = grown(maker, seed, np.zeros(config.betas, np.float32)), PATCHES * config.texels
    corner = jnp.zeros(2, jnp.int32) * CELL
    made = synthesise(config, maker.generator, maker.averages, latent.w, latent.phases, corner, (side, side))
    return np.asarray(made.feature[0])


def picture(seed: int, camera: tuple[float, ...]) -> Float[np.ndarray, "H W 3"]:
    """The material on a square of the patches."""
    material = ms.load_material(MATERIAL)
    scene = ms.Scene(
        "experiments/scenes/plane.obj",
        material,
        scale=1 / PATCHES,
        seed=seed,
        camera=camera,
        size=(SIDE, SIDE),
        lights=[(0.6, 0.7, 0.4)],
    )
    return over_white(ms.render(scene, samples=64).rgba)


def main() -> None:
    maker = generator_model(ms.load_material(MATERIAL).shell, MATERIAL)
    rows = []
    for seed in (1, 2):
        maps = [linear_to_srgb(as_colours(x))[::-1] for x in (inputs(maker, seed), texture(maker, seed))]
        rows.append([*maps, picture(seed, ABOVE), picture(seed, ASIDE)])
    titles = "Fourier map, 3 channels", "features, 3 channels", "from above", "from the side"
    draw("mesogan_4", rows, titles, ("seed 1", "seed 2"))


if __name__ == "__main__":
    main()
