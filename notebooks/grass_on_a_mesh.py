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
# # Grass on a mesh, step by step
#
# `mesoshell render` in slow motion: a mesh becomes a shell, rays become intervals, intervals become samples, samples
# become a picture. Every step is a plain function of arrays.

# %%
from importlib import resources
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from mesoshell.cli.marching import build_scene, facts
from mesoshell.cli.render import Options
from mesoshell.io.bundle import read_bundle
from mesoshell.io.material import find
from mesoshell.render.camera import pixel_grid, rays
from mesoshell.render.effects import plan_effects
from mesoshell.render.quality import PRESETS
from mesoshell.shell.boundary import Boundary
from mesoshell.shell.renderer import render

SIZE = 96
MESH = Path(str(resources.files("mesoshell") / "assets" / "spot.obj"))

# %% [markdown]
# ## The material
#
# A bundle is a feature texture with its pyramid, a feature along the height, a small network, and a grid of the largest
# density that lets the march skip empty space.

# %%
bundle = read_bundle(find("grass"))
print({key: value.shape for key, value in bundle.arrays.items() if not key.startswith(("features", "height", "grid"))})
print([f"{p.name}: {p.meaning}" for p in bundle.parameters])

# %%
finest = bundle.arrays["features/0"].astype(np.float32)
shown = finest[..., :3]
plt.imshow(np.clip((shown - shown.mean()) / (4 * shown.std()) + 0.5, 0, 1), origin="lower")
plt.title(f"first three of {bundle.channels} channels, {finest.shape[0]} texels a patch")
# %% [markdown]
# ## The shell
#
# The mesh is extruded along its vertex normals. Where the shell would fold into itself, it is made thinner.

# %%
scene, notes = build_scene(Options(mesh=MESH, size=(SIZE, SIZE)), bundle)
print(*notes, sep="\n")
height = np.linalg.norm(scene.shell.offset, axis=1)
print(f"{len(scene.shell.faces)} prisms, thickness {height.min():.3f} to {height.max():.3f}")

# %% [markdown]
# ## The march
#
# Each ray's way through the shell is a list of intervals, one a prism. Rays that graze cross many.

# %%
boundary = Boundary(scene.shell, scene.mesh.faces)
origin, direction = rays(scene.camera, pixel_grid(scene.camera, 1, 0))
traced = boundary.trace(np.ascontiguousarray(origin), direction)
count = np.bincount(traced.intervals.ray, minlength=SIZE * SIZE).reshape(SIZE, SIZE)
plt.imshow(count)
plt.colorbar(label="prisms")
plt.title(f"{traced.walked} visits, {traced.redone} of them repeated in float64")
# %% [markdown]
# ## The picture
#
# `plan_effects` decides what the scene calls for before anything is compiled.

# %%
quality = PRESETS["draft"]
effects = plan_effects(facts(scene), quality)
for name, effect in vars(effects).items():
    print("on " if effect.on else "off", name, "-", effect.why)

# %%
image, report = render(scene, quality, effects)
plt.imshow(np.clip(image[..., :3], 0, 1) ** (1 / 2.2))
plt.axis("off")
print(report.counts)

# %% [markdown]
# ## What accuracy costs
#
# Every knob is one field of `Quality`. Here the sample budget; the docs' performance page measures the others.

# %%
reference, _ = render(scene, quality.with_changes(samples=256, early_stop=0.0, skip=0.0), effects)
for samples in (8, 24, 64):
    image, report = render(scene, quality.with_changes(samples=samples), effects)
    error = np.sqrt(np.mean((image - reference) ** 2))
    print(f"{samples:3d} samples: error {error:.4f}, {report.counts['density_queries']:,} density queries")
