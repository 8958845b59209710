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
# A picture, and then the same in slow motion: a mesh becomes a shell, rays become intervals, intervals become samples, samples
# become a picture. Every step is a plain function of arrays.

# %%
from importlib import resources
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import mesoshell as ms
from mesoshell.render.camera import pixel_grid, rays
from mesoshell.render.quality import PRESETS
from mesoshell.scene.render_shell import marched_scene
from mesoshell.scene.setup import describe_shell
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.shell.render.renderer import render

SIZE = 64
MESH = Path(str(resources.files("mesoshell") / "assets" / "spot.obj"))

material = ms.load_material("grass")
scene = ms.Scene(MESH, material, size=(SIZE, SIZE))
picture = ms.render(scene, "draft")
picture  # noqa: B018  (it displays itself)

# %% [markdown]
# ## The material
#
# A bundle is a feature texture with its pyramid, a feature along the height, a small network, and a grid of the largest
# density that lets the march skip empty space.

# %%
bundle = material.shell
print({key: value.shape for key, value in bundle.arrays.items() if not key.startswith(("features", "height", "grid"))})
print([f"{name}: {p.meaning}" for name, p in material.parameters.items()])

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
described = describe_shell(scene)
print(*described.notes, sep="\n")
shell = described.shell
height = np.linalg.norm(shell.offset, axis=1)
print(f"{len(shell.faces)} prisms, thickness {height.min():.3f} to {height.max():.3f}")

# %% [markdown]
# ## The march
#
# Each ray's way through the shell is a list of intervals, one a prism. Rays that graze cross many.

# %%
boundary = Boundary(shell, described.mesh.faces)
origin, direction = rays(described.camera, pixel_grid(described.camera, 1, 0))
traced = boundary.trace(np.ascontiguousarray(origin), direction)
count = np.bincount(traced.intervals.ray, minlength=SIZE * SIZE).reshape(SIZE, SIZE)
plt.imshow(count)
plt.colorbar(label="prisms")
plt.title(f"{traced.walked} visits, {traced.redone} of them repeated in float64")
# %% [markdown]
# ## The picture
#
# What the scene calls for is decided before anything is compiled.

# %%
effects = ms.explain(scene, "draft")
print(effects)

# %%
marched, quality = marched_scene(described), PRESETS["draft"]
image, report = render(marched, quality, effects)
assert np.array_equal(image.astype(np.float32), picture.rgba)
print(report.counts)

# %% [markdown]
# ## What accuracy costs
#
# Every knob is one field of `Quality`. Here the sample budget; the docs' performance page measures the others.

# %%
quality = quality.with_changes(light_samples=0)
reference, _ = render(marched, quality.with_changes(samples=128, early_stop=0.0), effects)
for samples in (8, 24):
    image, report = render(marched, quality.with_changes(samples=samples), effects)
    error = np.sqrt(np.mean((image - reference) ** 2))
    print(f"{samples:3d} samples: error {error:.4f}, {report.counts['density_queries']:,} density queries")
