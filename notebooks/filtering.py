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
# # Grass from afar
#
# A pixel of a field covers many blades. Their features are averaged, and the network of an average is not the average of the
# network: a field against the sun was too bright, from above too dark. A correction by level and height mends most of it
# (`docs/concepts/filtering.md`).

# %%
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import mesoshell as ms
from mesoshell.measure.flip import flip

corrected = ms.load_material("grass")
arrays = {key: array for key, array in corrected.shell.arrays.items() if key != "correction"}
plain = ms.Material("grass without its correction", replace(corrected.shell, arrays=arrays))

# %% [markdown]
# ## What it is: numbers by level and height
#
# Added to the features before the network sees them. Level 0 has none, nor has a level that was better without: so near views
# stay.

# %%
delta = corrected.shell.arrays["correction"].astype(np.float32)
figure, axes = plt.subplots(figsize=(5.4, 2.6))
for level in (2, 4, 6, 8):
    axes.plot(
        (np.arange(delta.shape[1]) + 0.5) / delta.shape[1],
        np.sqrt((delta[level] ** 2).mean(axis=1)),
        label=f"level {level}",
    )
axes.set(xlabel="height h", ylabel="rms of δ over channels")
axes.legend(loc="upper left", ncols=2, fontsize=8)
plt.tight_layout()
plt.show()

# %% [markdown]
# ## How far views are from what they average
#
# Over random viewers, lights and ages, as `mesoshell prefilter` measured it: rms over the mean, before and after.

# %%
for level, (before, after) in enumerate(corrected.provenance["correction"]["rms"], 1):
    print(f"level {level}: {before:.0%}, corrected {after:.0%}")

# %% [markdown]
# ## A field, along the ground against the sun, and from above
#
# On the right many rays without a filter, which need no mean of features.


# %%
def field(material: ms.Material, camera: tuple[float, ...], light: tuple[float, ...]) -> ms.Scene:
    return ms.Scene("experiments/scenes/plane.obj", material, scale=0.03, camera=camera, size=(40, 30), lights=[light])


def shown(picture: ms.Picture) -> np.ndarray:
    return np.clip(picture.rgba[..., :3] + (1 - picture.rgba[..., 3:]) * 0.6, 0, 1) ** (1 / 2.2)


views = {
    "along": ((0.0, 0.045, 0.5, 0.0, 0.005, 0.2, 50.0), (0.6, 0.4, -0.5)),
    "from above": ((0.0, 0.5, 0.6, 0.0, 0.0, 0.0, 50.0), (0.6, 0.6, 0.5)),
}
figure, axes = plt.subplots(2, 3, figsize=(9.6, 5))
for row, (name, view) in zip(axes, views.items(), strict=True):
    pictures = {
        "averaged features": ms.render(field(plain, *view), "normal", footprint=1.0),
        "corrected": ms.render(field(corrected, *view), "normal", footprint=1.0),
        "no filter, 8 rays": ms.render(field(corrected, *view), "normal", filtering=False, samples=64, pixel_samples=8),
    }
    light = [picture.rgba[..., :3].mean() for picture in pictures.values()]
    for axis, (title, picture), mean in zip(row, pictures.items(), light, strict=True):
        axis.imshow(shown(picture))
        axis.set_title(f"{name}, {title}\n{mean / light[-1]:.2f} of the light", fontsize=9)
        axis.axis("off")
plt.tight_layout()
plt.show()

# %% [markdown]
# ## How wide a footprint
#
# `footprint` is the filter's width in pixels. Rays that share a pixel show what is finer than it; one ray alone is noisier with
# a narrow footprint. FLIP is against many rays without a filter.

# %%
hill = field(corrected, (0.0, 0.1, 0.3, 0.0, 0.0, 0.0, 40.0), (0.3, 0.5, 0.8))
fine = {"samples": 64, "coordinates": "exact", "density": "network"}
many = ms.render(hill, "normal", filtering=False, pixel_samples=16, **fine)
figure, axes = plt.subplots(1, 4, figsize=(11, 2.8))
for axis, footprint in zip(axes[:3], (1.0, 0.5, 0.25), strict=True):
    picture = ms.render(hill, "normal", footprint=footprint, pixel_samples=4, **fine)
    axis.imshow(shown(picture))
    axis.set_title(f"footprint {footprint}, FLIP {flip(picture.rgba[..., :3], many.rgba[..., :3]):.3f}", fontsize=9)
    axis.axis("off")
axes[3].imshow(shown(many))
axes[3].set_title("no filter, 16 rays", fontsize=9)
axes[3].axis("off")
plt.tight_layout()
plt.show()

# %% [markdown]
# A material of your own is corrected by `mesoshell prefilter mine.npz --out mine.npz`, or
# `ms.prefilter(material).save("mine.npz")`: some minutes on two cores, and no images.
