# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # From random phases to endless textures
#
# The generator before any training: what its layers are, what a seed is, why a texture has no edge and does not repeat, and how
# geometry varies over it. Training changes what the textures mean, and none of this.

# %%
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import mesoshell as ms
from mesoshell.io.exemplars import Exemplars
from mesoshell.measure.equivariance import eq_t
from mesoshell.measure.repetition import autocorrelation, largest_repeat
from mesoshell.shell.generator.generator import (
    draw_phases,
    init_averages,
    init_generator,
    map_latent,
    synthesise,
    synthesise_height,
)
from mesoshell.shell.generator.model import generator_model, grown
from mesoshell.shell.generator.plan import CELL, GeneratorConfig, frequencies_of, halo_cost, reach, rows_of
from mesoshell.train.gan.snapshot import as_colours
from mesoshell.train.textures.depth_map import from_above
from mesoshell.train.textures.exemplars import scale_exemplars
from mesoshell.train.textures.state import TexturesConfig
from mesoshell.train.textures.step import start
from mesoshell.train.textures.synthesis import latents, own_phases, synthesise_patch

config = GeneratorConfig(32, channel_base=512, channel_max=16, channels=8, layers=7, waves=16, z=16, w=16, betas=1)
generator, averages = init_generator(config, jax.random.key(0)), init_averages(config)

# %% [markdown]
# ## Layers
#
# Cutoffs rise layer by layer, and with them the rate of the samples. Each layer's input gets a *Fourier map*: sinusoids between
# the cutoffs of its input and output, so that there is something in the new band to shape.

# %%
print("layer  cutoff in → out   samples a patch   channels   waves")
for i, (row, f) in enumerate(zip(rows_of(config), frequencies_of(config).layers, strict=True)):
    print(
        f"{i:5}  {row.in_cutoff:6.2f} → {row.out_cutoff:5.2f}   {row.in_sampling_rate:6.0f} → {row.out_sampling_rate:4.0f}"
        f"   {row.in_channels:4} → {row.out_channels:3}   {len(f):5}"
    )

# %% [markdown]
# ## A texture is a seed
#
# A latent z and the waves' phases. Both are drawn; nothing else is. Ask for any rectangle of the plane.


# %%
@partial(jax.jit, static_argnums=(0, 1))
def synthesised(config, size, w, phases, tile):
    return synthesise(config, generator, averages, w, phases, tile, size).feature[0]


def texture(config, seed, size, corner=(0, 0), beta=0.5):
    k = jax.random.split(jax.random.key(seed))
    z = jax.random.normal(k[0], (1, config.z))
    w = map_latent(generator, z, jnp.full((1, 1), beta))
    phases = draw_phases(config, k[1], 1)
    tile = jnp.array(corner, jnp.int32) * CELL
    return np.asarray(synthesised(config, size, w, phases, tile))


figure, axes = plt.subplots(1, 3, figsize=(11, 4))
for seed, axis in enumerate(axes):
    axis.imshow(as_colours(texture(config, seed, (64, 128))) ** (1 / 2.2), origin="lower", extent=(0, 4, 0, 2))
    axis.set_title(f"seed {seed}: 4 × 2 patches")
# %% [markdown]
# ## It has no edge
#
# No layer pads: it is evaluated where the next one asks for it. So a tile is a part of the plane, to rounding, at the price of
# a halo. Here is one that begins a patch higher and two farther along u.

# %%
whole, other = texture(config, 0, (64, 128)), texture(config, 0, (64, 128), corner=(1, 2))
apart = np.abs(whole[32:, 64:] - other[:32, :64]).max()
print(f"largest difference where both are: {apart:.1e}, of a standard deviation of {whole.std():.2f}")
print(
    f"multiplications over those without a halo: one patch {halo_cost(config, 32):.1f}, 4 × 4 {halo_cost(config, 128):.1f}"
)
assert apart < 1e-4 * whole.std()

# %% [markdown]
# ## It does not repeat
#
# One sinusoid a channel is what the paper has. Few sinusoids are nearly in step again somewhere, by chance. More of them cost
# next to nothing, since sines are taken on the two axes alone.

# %%
figure, axes = plt.subplots(1, 2, figsize=(8, 4))
for waves, axis in zip((1, 16), axes, strict=True):
    f = texture(replace(config, waves=waves), 0, (128, 128))
    value, lag = largest_repeat(f, 32)
    axis.imshow(autocorrelation(f)[64:191, :64], vmin=-0.5, vmax=0.5, cmap="RdBu_r", extent=(0, 2, -2, 2))
    axis.set_title(f"{waves} a channel: at most {value:.2f}")
    print(f"{waves} a channel: {value:.2f} at a lag of {lag[1] / 32:.1f} patches along u, {lag[0] / 32:.1f} along v")
# %% [markdown]
# ## It follows its waves
#
# Moving the phases moves the texture. How exactly, in decibels: EQ-T, here by 5 and 9 texels, fractions of a sample in the
# inner layers.

# %%
w = map_latent(generator, jax.random.normal(jax.random.key(1), (1, config.z)), jnp.full((1, 1), 0.5))
print(f"EQ-T {eq_t(config, (generator, averages), w, draw_phases(config, jax.random.key(2), 1), (5.0, 9.0)):.1f} dB")

# %% [markdown]
# ## Geometry may vary over it
#
# A geometry parameter (a length, a direction in which pile is combed) goes through the mapping network into w, and w may lie on
# the corners of patches, with what is between them interpolated. Left to right: 0, a ramp from 0 to 1, 1.

# %%
z, phases = jax.random.normal(jax.random.key(5), (1, config.z)), draw_phases(config, jax.random.key(6), 1)
size, before = (32, 192), reach(config, (32, 192))
nodes = 2 * before + 6 + 1, 2 * before + 1 + 1
ramp = np.clip((np.arange(nodes[0]) - before - 1) / 4, 0, 1)
varied = {}
for name, beta in (("0", 0 * ramp), ("ramp", ramp), ("1", 0 * ramp + 1)):
    w = map_latent(generator, jnp.broadcast_to(z, (len(beta), config.z)), jnp.asarray(beta, jnp.float32)[:, None])
    on_nodes = jnp.broadcast_to(w[None, None], (1, nodes[1], *w.shape))
    varied[name] = np.asarray(synthesised(config, size, on_nodes, phases, jnp.zeros(2, jnp.int32)))

figure, axes = plt.subplots(3, 1, figsize=(10, 6), layout="constrained")
together = as_colours(np.concatenate(list(varied.values()))) ** (1 / 2.2)  # one scale of colours for all
for name, picture, axis in zip(varied, np.split(together, 3), axes, strict=True):
    axis.imshow(picture, origin="lower", extent=(0, 6, 0, 1))
    axis.set_title(f"parameter: {name}")
# %% [markdown]
# ## What it learns from, and where it begins
#
# A generator may learn fitted textures before it sees a picture. From above, without a ray, the bundled grass shows its blades
# by their heights. An untrained generator of that kind begins with the same power in each octave, mean and covariance: a fog of
# the right colours and heights, which training then turns into blades.

# %%
bundle = ms.load_material("grass").shell
weights = {k: v for k, v in bundle.arrays.items() if k.startswith("decoder/") or k == "sigma_scale"}
exemplar = bundle.arrays["features/3"][None], bundle.arrays["height/0"], np.zeros((1, 0), np.float32)
data = scale_exemplars(Exemplars(*exemplar, weights, bundle.height_octaves, bundle.parameters, {}))
small = replace(
    config, texels=32, channel_base=512, channels=32, layers=4, waves=4, drift=1.5, z=0, betas=0, height_rows=64
)
learning = TexturesConfig(small)
state = start(learning, data, jax.random.key(0))
w, phases = latents(learning, state.generator, jnp.zeros((1, 0))), own_phases(learning, jnp.arange(1))
field = jax.jit(synthesise_patch, static_argnums=(0, 5))(learning, state, state.generator, w, phases, small.texels)[0]
looked_at = jax.jit(from_above, static_argnums=(1, 5))
figure, axes = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
for axis, f, name in zip(axes, (data.features[0], field[0]), ("fitted", "where learning begins"), strict=True):
    given = jnp.asarray(f), jnp.asarray(data.height), jnp.full(1, 0.2)
    seen = looked_at(data.decoder, bundle.height_octaves, *given, 16)
    axis.imshow(seen.depth, cmap="gray", vmin=0, vmax=1, origin="lower")
    axis.set_title(f"{name}: height of what is seen from above")
assert abs(float(jnp.mean(field))) < 0.3 and 0.5 < float(jnp.std(field)) < 2

# %% [markdown]
# And where it has got to: `carpet`, which learned 64 fitted patches against a critic that was told the direction in which each
# was combed. The same phases, combed four ways.

# %%
synthesised = jax.jit(synthesise, static_argnums=(0, 6))
heights = jax.jit(synthesise_height, static_argnums=0)


def seen_from_above(maker, seed, beta, alpha):
    """A corner of a patch of a bundled generator."""
    latent = grown(maker, seed, np.array(beta, np.float32))
    given = maker.config, maker.generator, maker.averages, latent.w, latent.phases, jnp.zeros(2, jnp.int32), (32, 32)
    height = heights(maker.config, maker.generator, latent.w)[0]
    return looked_at(maker.decoder, maker.octaves, synthesised(*given).feature[0], height, jnp.array(alpha), 16)


carpet = generator_model(ms.load_material("carpet").shell, "carpet")
figure, axes = plt.subplots(1, 4, figsize=(12, 3.4), layout="constrained")
depths = [seen_from_above(carpet, 0, [0.7, turn / 4], [0.6]).depth for turn in range(4)]
for turn, axis in enumerate(axes):
    axis.imshow(depths[turn], cmap="gray", vmin=0, vmax=1, origin="lower")
    axis.set_title(f"combed at {90 * turn}°")
    assert float(jnp.std(depths[turn])) > 0.05
assert np.abs(np.corrcoef([np.ravel(x) for x in depths])[np.triu_indices(4, 1)]).max() < 0.9

# %% [markdown]
# `fur` was told the length of each patch in the same way: three lengths of one seed, and the longest of another.

# %%
fur = generator_model(ms.load_material("fur").shell, "fur")
figure, axes = plt.subplots(1, 4, figsize=(12, 3.4), layout="constrained")
shown = [(0, 0.25), (0, 0.6), (0, 0.95), (1, 0.95)]
depths = [seen_from_above(fur, seed, [(length - 0.25) / 0.7, 0.2], [0.1, 0.7, 0.6]).depth for seed, length in shown]
for (seed, length), depth, axis in zip(shown, depths, axes, strict=True):
    axis.imshow(depth, cmap="gray", vmin=0, vmax=1, origin="lower")
    axis.set_title(f"seed {seed}: {length} box heights long")
assert np.all(np.diff([float(jnp.mean(depth)) for depth in depths[:3]]) > 0.03)

# %% [markdown]
# From here: `mesoshell train` teaches the generator what to grow, `mesoshell texture` writes a texture to disk, and
# `mesoshell render mesh.obj --material grass.npz --seed 3` grows one on a mesh. See `docs/tutorials/train.md`.
