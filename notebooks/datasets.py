# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     name: python3
# ---

# %% [markdown]
# # Training images of fur
#
# Blender renders a slab of fur from many sides, under many lights, with random lengths and colours. Here are a dozen small
# images: how they are made, what they hold, and how training reads them. `docs/how_to/blender.md` has the commands.
# It needs the Blender environment: `make blender`.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from mesoshell.datasets.blender.process import Blender
from mesoshell.datasets.blender.render import Farm, render_dataset
from mesoshell.datasets.blender.vary import vary_sheet
from mesoshell.io.dataset import read_dataset
from mesoshell.io.dataset_check import check_dataset
from mesoshell.io.image import linear_to_srgb
from mesoshell.io.pack import pack_dataset
from mesoshell.io.sheet import contact_sheet
from mesoshell.train.loader import Feed

folder = Path(tempfile.mkdtemp())

# %% [markdown]
# What all images of a dataset share. `None` means the recipe's own choice; `patch` is None, so every image shows new hairs.

# %%
settings = {"recipe": "fur", "seed": 0, "size": 48, "samples_per_pixel": 4, "denoise": False}
settings |= {"coverage": (0.3, 1.0), "fixed": {}, "patch": None, "views": None}
report = render_dataset(settings, 12, folder / "fur", Farm(workers=1, threads=2), lambda finished, missing, fault: None)
assert not report.faults and check_dataset(folder / "fur") == []
dataset = read_dataset(folder / "fur")


def show(linear: np.ndarray) -> None:
    plt.figure(figsize=(9, 9 * linear.shape[0] / linear.shape[1]))
    plt.imshow(linear_to_srgb(np.clip(linear, 0, 1)))
    plt.axis("off")
    plt.show()


show(contact_sheet(dataset, sort="length", columns=6))

# %% [markdown]
# A sample knows all that made it. β (length, roughness) shapes the hairs, α (hue, saturation, value) colours them.

# %%
sample = dataset.samples[3]
print(sample.parameters, f"radius {sample.radius:.2f}, light {sample.light.round(2)}, E⊥ {sample.irradiance}")

# %% [markdown]
# What each parameter does, alone, from its least value to its greatest.

# %%
with Blender(settings | {"coverage": (0.85, 0.85)}, threads=2) as blender:
    show(vary_sheet(blender, steps=2, index=3, show=lambda done, of: None))
print("rows:", ", ".join(blender.manifest["parameters"]))

# %% [markdown]
# Training reads packed images: arrays on disk, mapped into memory, here at half the size. A batch depends on its step alone, so
# training that stopped goes on where it was.

# %%
pack_dataset(dataset, folder / "fur24", size=24)
feed = Feed(read_dataset(folder / "fur24"), batch=4, seed=0)
batch = feed[0]
print(batch.image.shape, batch.image.dtype, "beta", batch.beta[0].round(2), "alpha", batch.alpha[0].round(2))
assert np.array_equal(next(feed.after(5)).index, feed[5].index)
