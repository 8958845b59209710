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
# # From photographs to a texture that can be painted on
#
# A cow is photographed by Blender, learned as a density volume with a texture that it discovers itself, painted on, and
# turned into a mesh. (Half a minute's training, of small pictures: `docs/tutorials/photographs.md` has longer ones.)

# %%
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import mesoshell as ms
from mesoshell.datasets.blender.photograph import PhotographConfig, photograph
from mesoshell.geometry.mesh import load_mesh
from mesoshell.io.image import linear_to_srgb
from mesoshell.measure.captured import score_views
from mesoshell.neutex import edit as paint
from mesoshell.neutex.capture import read_capture
from mesoshell.neutex.layout import directions
from mesoshell.neutex.mesh import extract_mesh
from mesoshell.neutex.render import picture, view
from mesoshell.neutex.store import read_neutex
from mesoshell.render.quality import Quality
from mesoshell.train.gan.presets import TINY
from mesoshell.train.neutex.snapshot import board_paint
from mesoshell.train.neutex.step import adapt, neutex_config

folder = Path(tempfile.mkdtemp())
config = PhotographConfig(views=12, size=32, spp=4, paint=None, flash=False, up=1, points=1000, noise=0.005, seed=0)
photograph(load_mesh("src/mesoshell/assets/spot.obj"), config, folder / "capture", lambda n: None)
capture = read_capture(folder / "capture")


def show(axis, image, title=""):
    axis.imshow(linear_to_srgb(np.clip(image, 0, 1)))
    axis.set(title=title, xticks=[], yticks=[])


figure, axes = plt.subplots(1, 6, figsize=(12, 2.2))
for axis, i in zip(axes, range(0, 12, 2), strict=True):
    show(axis, capture.rgb[i], f"view {i}")

# %% [markdown]
# ## What the masks alone say
#
# Cells that lie inside all masks: they give the box that all else happens in. If poses, lenses or masks did not fit each
# other, the share on which views agree would fall, and a warning would name it.

# %%
print(f"centre {capture.centre.round(3)}, half side {capture.half:.3f}")
print(f"agreement {capture.agreement:.1%}, warnings: {capture.warnings}")
figure, axes = plt.subplots(1, 3, figsize=(9, 3))
for axis, along in zip(axes, range(3), strict=True):
    axis.imshow(capture.hull.inside.sum(axis=along).T[::-1], cmap="gray")
    axis.set(title=f"hull, along {'xyz'[along]}", xticks=[], yticks=[])

# %% [markdown]
# ## Learning it

# %%
config = replace(neutex_config(TINY), batch=96, samples=12, kimg=96 * 0.25, snapshot_kimg=96 * 0.25)
rows = []
run = ms.train(config, capture, folder / "run", show=rows.append)
found = read_neutex(max(run.snapshots.values()))
config, capture = adapt(config, capture)
for name, score in score_views(found, capture, config.samples).items():
    print(f"{name}: {score.value:.3g}")
figure, axis = plt.subplots(figsize=(6, 3))
for name in ("render", "mask", "cycle"):
    axis.semilogy([row["kimg"] for row in rows], [row[name] for row in rows], label=name)
axis.set(xlabel="thousand rays", ylabel="loss")
axis.legend()

# %% [markdown]
# A view that was not learned from: photograph, render, and a checkerboard in the texture's place. Where squares are of one
# size and none is torn, the texture can be painted on.


# %%
def seen(i, edit=None, **changes):
    how = view(found.config, found.field, Quality(**{"samples": config.samples, "pixel_samples": 1, **changes}), edit)
    return picture(found.config, found.field, found.to_box(capture.photos[i]), how).rgba[..., :3]


figure, axes = plt.subplots(1, 3, figsize=(9, 3))
show(axes[0], capture.rgb[7], "photograph")
show(axes[1], seen(7), "render")
show(axes[2], seen(7, board_paint()), "checkerboard")

# %% [markdown]
# ## Painting on it
#
# A ring, drawn into the texture's image, lies on the surface wherever it is seen from.

# %%
texture = paint.texture_image(found, "latlong", 64)
u = directions("latlong", 64)
ring = np.abs(u @ np.array([0.0, 0.8, 0.6]) - 0.3)[..., None] < 0.12
edited = np.where(ring, np.array([0.05, 0.2, 0.9]), texture).astype(np.float32)
edit = paint.paint_of(found, "latlong", edited, "replace")
figure, axes = plt.subplots(1, 4, figsize=(14, 3))
show(axes[0], texture, "texture")
show(axes[1], edited, "edited")
show(axes[2], seen(3, edit), "from one side")
show(axes[3], seen(10, edit), "from another")

# %% [markdown]
# ## What accuracy costs
#
# Samples a ray, against many.

# %%
reference = seen(7, samples=32, early_stop=0.0, skip=0.0)
for samples in (8, config.samples):
    print(f"{samples:2d} samples: mean error {np.abs(seen(7, samples=samples) - reference).mean():.2g}")

# %% [markdown]
# ## The surface as a mesh
#
# The inverse map wraps a sphere around the object: a closed mesh with the texture's own coordinates, that shells grow on.

# %%
surface = extract_mesh(found.config, found.field, 24, 64)
figure = plt.figure(figsize=(5, 5))
axes = figure.add_subplot(projection="3d")
x, y, z = surface.vertices.T
axes.plot_trisurf(x, -z, y, triangles=surface.faces, color="0.8", linewidth=0)
axes.set_aspect("equal")
print(f"{len(surface.faces)} triangles")
