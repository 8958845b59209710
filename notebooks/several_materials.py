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
# # Several materials, each with its own values
#
# A furry cow stands on a hill of grass: one picture, two shells. Each mesh has parameters, thickness and seed of its own, by
# its name.

# %%
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import mesoshell as ms
from mesoshell.film.shoot import on_white
from mesoshell.io.image import linear_to_srgb

pelt, turf = ms.load_material("pelt"), ms.load_material("turf")
hill = ms.Grown("experiments/scenes/hill.obj", turf, scale=0.35, name="hill")
camera = (2.2, 0.7, -3.2, 0.0, -0.2, 0.0, 36.0)
scene = ms.Scene("src/mesoshell/assets/spot.obj", pelt, params={"hue": 0.08}, also=[hill], camera=camera, size=(48, 48))


def show(images: list[np.ndarray], names: list[str]) -> None:
    """Linear pictures side by side."""
    _, axes = plt.subplots(1, len(images), figsize=(3 * len(images), 3), squeeze=False)
    for axis, image, name in zip(axes[0], images, names, strict=True):
        axis.imshow(linear_to_srgb(np.clip(image, 0, 1)))
        axis.set_title(name)
        axis.axis("off")
    plt.show()


def over_white(picture: ms.Picture) -> np.ndarray:
    return picture.rgba[..., :3] + 1 - picture.rgba[..., 3:]


# %% [markdown]
# ## What each costs
#
# The same camera, with either mesh bare and with both: rays are traced once, so both take less than the sum.

# %%
scenes = {
    "fur, the hill bare": replace(scene, also=(), objects=["experiments/scenes/hill.obj"]),
    "grass, the cow bare": ms.Scene(hill.mesh, turf, scale=0.35, objects=[scene.mesh], camera=camera, size=scene.size),
    "both": scene,
    "a dry, high hill": replace(scene, also=[replace(hill, params={"age": 1.0}, thickness=0.5)]),
}
pictures = {name: [ms.render(one, "draft") for _ in range(2)][1] for name, one in scenes.items()}  # the first compiles
show([over_white(picture) for picture in pictures.values()], list(pictures))
for name, picture in pictures.items():
    print(f"{name}: {picture.report['seconds']['wall']:.1f} s, {picture.report['queries'] / 1e6:.2f} million queries")

# %% [markdown]
# ## Over time
#
# A key's parameter is the cow's; with a name before it, the hill's. (`mesoshell film --keys` takes the same, as JSON;
# `mesoshell view` has sliders and a brush for each.)

# %%
keys = [
    {"frame": 0, "params": {"hue": 0.08, "hill:age": 0.0, "hill:thickness": 0.1}},
    {"frame": 2, "params": {"hue": 0.12, "hill:age": 1.0, "hill:thickness": 0.4}},
]
film = ms.film(scene, Path(tempfile.mkdtemp()) / "film", keys=keys, quality="draft")
show([on_white(path) for path in film.frames], [f"frame {k}" for k in range(3)])
