"""A generator that learned four patches of grass at fixed phases, and what it makes beyond them.

`materials/grass_textures.npz` is of experiments/textures.py: regression, each exemplar at phases of its own. So it has seen one
patch at these phases, from the origin on, as a generator without random phases does.
"""

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

import mesoshell as ms
from mesoshell.io.bundle import read_bundle
from mesoshell.io.level_arrays import split
from mesoshell.scene.materials import Material
from mesoshell.shell.generator.bake import bake
from mesoshell.shell.generator.generator import map_latent
from mesoshell.shell.generator.model import Latent, generator_model
from mesoshell.train.textures.state import TexturesConfig
from mesoshell.train.textures.synthesis import own_phases

FILE = "materials/grass_textures.npz"


def learned(patches: tuple[int, int], exemplar: int = 0) -> Material:
    """A texture of patches (v, u) whose first one was learned."""
    bundle = read_bundle(FILE)
    maker, arrays = generator_model(bundle, FILE), {k: v for k, v in bundle.arrays.items() if "generator/" not in k}

    def keep(name: str, shapes) -> list[np.ndarray]:
        levels = split(np.zeros(sum(map(math.prod, shapes)), np.float16), shapes)
        arrays.update((f"{name}/{i}", level) for i, level in enumerate(levels))
        return levels

    config = TexturesConfig(maker.config, seed=bundle.provenance["config"]["seed"])
    w = map_latent(maker.generator, jnp.zeros((1, maker.config.z)), jnp.zeros((1, 0)))
    size = patches[0] * maker.config.texels, patches[1] * maker.config.texels
    bake(maker, Latent(w, own_phases(config, jnp.array([exemplar]))), size, keep)
    return Material("learned", replace(bundle, arrays=arrays, generator=None))


def above(material: Material, patches: int, **more) -> np.ndarray:
    """A row of patches from above, linear RGBA of 128 pixels a patch."""
    high, z = 6.0, 0.5 - 0.5 / patches
    angle = 2 * np.degrees(np.arctan(0.5 / patches / (high - 0.5 / patches)))
    scene = ms.Scene(
        "experiments/scenes/plane.obj",
        material,
        scale=1 / patches,
        camera=(0.0, high, z + 1e-3, 0.0, 0.0, z, float(angle)),
        size=(128 * patches, 128),
        lights=[(0.6, 0.8, 0.3)],
        **more,
    )
    return ms.render(scene, samples=64, pixel_samples=4).rgba
