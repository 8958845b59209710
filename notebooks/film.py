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
# # A film, and how much it flickers
#
# A camera goes around a cow of grass, and comes nearer; parameters change over time. What differs between two frames beside
# what the camera's motion explains is their flicker. (Small frames and few samples here; larger ones in `docs/how_to/film.md`.)

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import mesoshell as ms
from mesoshell.film.shoot import on_white
from mesoshell.io.image import linear_to_srgb

folder = Path(tempfile.mkdtemp())
scene = ms.Scene("src/mesoshell/assets/spot.obj", ms.load_material("grass"), size=(48, 48))


def show(film: ms.Film) -> None:
    """The frames in a row."""
    row = np.concatenate([linear_to_srgb(on_white(path)) for path in film.frames], axis=1)
    plt.figure(figsize=(10, 10 * row.shape[0] / row.shape[1]))
    plt.imshow(row)
    plt.axis("off")
    plt.show()


# %% [markdown]
# ## Around, and nearer

# %%
around = ms.film(scene, folder / "orbit", orbit=3, quality="draft")
show(around)
nearer = ms.film(scene, folder / "dolly", dolly=3, far=4.0, quality="draft")
show(nearer)

# %% [markdown]
# ## Keys
#
# Numbers go smoothly from key to key, and never beyond them: grass grows, then it withers.

# %%
keys = [
    {"frame": 0, "thickness": 0.01, "params": {"age": 0.0}},
    {"frame": 1, "thickness": 0.1, "params": {"age": 0.0}},
    {"frame": 2, "params": {"age": 1.0}},
]
show(ms.film(scene, folder / "keys", keys=keys, quality="draft"))

# %% [markdown]
# ## What flickers
#
# Of the orbit, whose camera turns by 120° a frame, no two frames show the same places well. The dolly's flicker falls with more
# samples a ray and pixel: what is left is what warping blurs, and parallax within the grass.

# %%
better = ms.film(scene, folder / "better", dolly=3, far=4.0, quality="normal")
for name, film in (("draft", nearer), ("normal", better)):
    plt.plot(range(1, 3), film.flicker[1:], label=f"{name}, {np.median(film.seconds):.1f} s a frame")
plt.xlabel("frame")
plt.ylabel("flicker, mean FLIP")
plt.legend()
plt.show()
