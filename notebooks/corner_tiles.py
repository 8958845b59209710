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
# # Corner tiles: a fitted material without rows
#
# One fitted patch, laid again and again, stands in rows. `turf` is sixteen patches that fit together in many orders. Here: the
# sixteen, how a plane is laid of them, and what that does to rows.

# %%
from functools import partial

import jax
import matplotlib.pyplot as plt
import numpy as np

import mesoshell as ms
from mesoshell.io.corner_tiles import SIDE, seed_origin
from mesoshell.measure import above
from mesoshell.measure.repetition import largest_repeat
from mesoshell.shell.material.corner_tiles import on_torus
from mesoshell.shell.material.loader import load_device_material

turf, grass = ms.load_material("turf").shell, ms.load_material("grass").shell
colours = np.array(turf.tiles)
print(
    {
        name: f"{bundle.arrays['features/0'].shape} texels, channels"
        for name, bundle in (("turf", turf), ("grass", grass))
    }
)


# %%
def picture(bundle, patches, pixels, seed=0):
    """A field from straight above, under an aslant light, at age 0, in x/(1 + x)."""
    material = load_device_material(bundle, seed_origin(seed) if bundle.tiles else (0, 0))
    return above.picture(material, np.zeros(1, np.float32), (patches, pixels), (0.6, 0.0, 0.8), 24)


def show(ax, image, patches, title):
    ax.imshow(image ** (1 / 2.2), origin="lower", extent=(0, patches, 0, patches))
    ax.set(title=title, xticks=[], yticks=[])


# %% [markdown]
# ## Sixteen tiles
#
# Each corner of the patch lattice has one of two colours, here black and white. A tile is named by the colours of its four
# corners, so there are 16. Blades that cross an edge follow from that edge's two colours: two tiles that share them fit. On a
# torus of 4 × 4 patches each tile lies once; the fit learns that torus.

# %%
PATCHES, PIXELS = 8, 32
plane = picture(turf, PATCHES, PIXELS)
middles = np.arange(PATCHES, dtype=np.float32) + 0.5
looked_up = jax.vmap(partial(on_torus, turf.tiles, None))(np.stack(np.meshgrid(middles, middles), -1).reshape(-1, 2))
tile = np.floor(looked_up).astype(int).reshape(PATCHES, PATCHES, 2) @ [1, SIDE]


def cut(number):
    """One tile, where the plane shows it first."""
    j, i = np.argwhere(tile == number)[0] * PIXELS
    return plane[j : j + PIXELS, i : i + PIXELS]


fig, axes = plt.subplots(SIDE, SIDE, figsize=(6, 6), gridspec_kw={"wspace": 0.12, "hspace": 0.12})
for number, ax in enumerate(axes[::-1].ravel()):
    show(ax, cut(number), 1, "")
    i, j = number % SIDE, number // SIDE
    for a, b in ((0, 0), (1, 0), (0, 1), (1, 1)):
        colour = colours[(j + b) % SIDE, (i + a) % SIDE]
        ax.plot(a, b, "o", color=str(float(colour)), markeredgecolor="grey", markersize=9, clip_on=False)
plt.show()

# %% [markdown]
# ## A field, before and after
#
# A hash of a corner's place is its colour, so a plane needs no memory and has no end. The largest repeat is the largest
# autocorrelation of the picture at lags of a patch or more: 1 for a patch that repeats.

# %%
fields = {"grass: one patch": picture(grass, 10, 20), "turf: sixteen tiles": picture(turf, 10, 20)}
fig, axes = plt.subplots(1, 2, figsize=(10, 5))
for ax, (name, image) in zip(axes, fields.items(), strict=True):
    show(ax, image, 10, f"{name}, repeat {largest_repeat(image, 20)[0]:.2f}")
plt.show()

# %% [markdown]
# ## Seeds
#
# A seed is another part of the plane, far away. `mesoshell render field.obj --material turf --seed 7` does the same.

# %%
fig, axes = plt.subplots(1, 3, figsize=(12, 4))
for seed, ax in enumerate(axes):
    image = picture(turf, 10, 20, seed) if seed else fields["turf: sixteen tiles"]
    show(ax, image, 10, f"seed {seed}, repeat {largest_repeat(image, 20)[0]:.2f}")
plt.show()
