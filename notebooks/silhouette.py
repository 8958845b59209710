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
# # A surface material that knows its silhouette
#
# Balls on a body are bent onto a few cylinders, and rays asked what they meet. A small network learns the answers, and is put
# on a torus: one query a hit, and rays pass between the balls at its rim. (Real ones are trained hundreds of times as long:
# `docs/how_to/surface_material.md`.)

# %%
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import mesoshell as ms
from mesoshell.datasets.queries.sources import source
from mesoshell.datasets.queries.tile import PatchPlacement
from mesoshell.datasets.queries.trace import Patch, queries

tile = source("spheres")
print(f"{len(tile.faces)} triangles a period, {tile.depth} deep")

# %% [markdown]
# ## What is learned
#
# The same place seen at the same angle, on a plane and on cylinders. Where nothing is met, blue.

# %%
SIDE = 32
y, x = np.meshgrid(np.linspace(0.5, -0.5, SIDE), np.linspace(-0.5, 0.5, SIDE), indexing="ij")
place = np.stack([x, y], axis=-1).reshape(-1, 2)
figure, axes = plt.subplots(1, 4, figsize=(12, 3))
for axis, (curvature, cosine) in zip(axes, ((0.0, 1.0), (0.0, 0.4), (1.0, 0.4), (2.0, 0.4)), strict=True):
    placing = PatchPlacement(curvature)
    toward = np.array([np.sqrt(1 - cosine**2), 0, cosine])
    asked = {
        "place": place,
        "radius": np.full(len(place), 0.003),
        "toward": np.tile(toward, (len(place), 1)),
        "light": np.tile(np.array([-0.5, 0.4, 0.768]), (len(place), 1)),
    }
    found = queries(Patch(tile, placing, (2.5, 2.0)), placing, asked, spp=4, seed=0)
    behind = (1 - found["alpha"]) * np.array([0.1, 0.2, 0.8])
    shown = np.clip(4 * found["reflectance"] + behind, 0, 1) ** (1 / 2.2)
    axis.imshow(shown.reshape(SIDE, SIDE, 3))
    axis.set(title=f"κ {curvature:g}, cosine {cosine:g}", xticks=[], yticks=[])

# %% [markdown]
# ## Learning it
#
# Patches of random curvature, and a hundred small steps.

# %%
from mesoshell.datasets.queries.render import Settings, of_geometry, render_patches  # noqa: E402
from mesoshell.train.gan.presets import TINY  # noqa: E402
from mesoshell.train.surface.step import surface_config  # noqa: E402

folder = Path(tempfile.mkdtemp())
settings = Settings("spheres", tile.depth, (-1.0, 2.0), queries=2048, spp=4, seed=0)
render_patches(settings, of_geometry(tile, settings.spp), 6, folder / "data", lambda done, of: None)
log = []
config = replace(surface_config(TINY), kimg=100.0, rate=8e-3)
run = ms.train(config, folder / "data", folder / "run", show=log.append)
figure, axis = plt.subplots(figsize=(6, 3))
for name in ("reflectance", "opacity"):
    axis.semilogy([row["kimg"] for row in log], [row[name] for row in log], label=name)
axis.set(xlabel="thousand queries", ylabel="loss")
axis.legend()

# %% [markdown]
# ## On a torus
#
# Curvature comes from the mesh. Without opacity, the rim is the torus's own.

# %%
from mesoshell.geometry.mesh import check_mesh  # noqa: E402

around, across = 48, 24
i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
ring, tube = 6 / (2 * np.pi), 2.4 / (2 * np.pi)
p, t = i / around * 2 * np.pi, j / across * 2 * np.pi
reach = ring + tube * np.cos(t)
points = np.stack([reach * np.cos(p), tube * np.sin(t), -reach * np.sin(p)], axis=-1).reshape(-1, 3)
square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
cell = np.stack([i, j], axis=-1).reshape(-1, 1, 2) + square
index = cell[..., 0] % around * across + cell[..., 1] % across
uv = cell * np.array([6 / around, 2.4 / across])
halves = np.array([[0, 1, 2], [0, 2, 3]])
mesh = check_mesh(points, index[:, halves].reshape(-1, 3), uv[:, halves].reshape(-1, 3, 2), "torus")

material = run.material()
camera = ms.Camera(ms.look_at((0.0, 1.6, 3.2), (0.75, 0.1, 0.3)), 0.36, 64, 48)
scene = ms.Scene(mesh, material, scale=0.6, camera=camera, lights=[(-0.5, 0.7, 0.5)], irradiance=6.0)
opaque = replace(scene, material=ms.Material("opaque", replace(material.surface, opacity="none")))
figure, axes = plt.subplots(1, 2, figsize=(12, 4.5))
for axis, one, title in zip(axes, (scene, opaque), ("with opacity", "without"), strict=True):
    picture = ms.render(one, "draft")
    axis.imshow(np.clip(picture.rgba, 0, 1) ** (1 / 2.2))
    axis.set(title=f"{title}: {picture.report['queries']:,} queries", xticks=[], yticks=[])
