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
# # A shell in a scene of Mitsuba's
#
# `ms.mitsuba` reads a scene as `mi.load_dict` does, but that a mesh may have a `mesoshell` BSDF. What comes back is
# an ordinary `mi.Scene`, and `mi.render` renders it.

# %%
import time
from importlib import resources

import matplotlib.pyplot as plt
import numpy as np

import mesoshell as ms
from mesoshell.render.quality import PRESETS

load_dict = ms.mitsuba.load_dict
import mitsuba as mi  # noqa: E402  (after ms.mitsuba, which names a libLLVM that works)

SIZE = 48
MESH = str(resources.files("mesoshell") / "assets" / "spot.obj")


def scene(**more) -> dict:
    view = mi.ScalarTransform4f().look_at([1.6, 0.9, -2.5], [0, 0.1, 0.15], [0, 1, 0])
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    turf = {"type": "mesoshell", "material": "grass", "thickness": 0.06, "scale": 0.12, "age": 0.3}
    ground = mi.ScalarTransform4f().translate([0, -0.74, 0]).rotate([1, 0, 0], -90).scale(20)
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sensor": {"type": "perspective", "fov": 36, "to_world": view, "film": film},
        "sky": {"type": "constant"},
        "ground": {"type": "rectangle", "to_world": ground},
        "spot": {"type": "obj", "filename": MESH, "bsdf": turf},
        **more,
    }


def shown(image: np.ndarray) -> np.ndarray:
    return np.clip(image[..., :3], 0, 1) ** (1 / 2.2)


# %% [markdown]
# ## What the scene calls for
#
# Effects are decided from the scene before anything is compiled. This one has an environment that paths may meet, and a surface
# that is not convex, so that light which leaves the shell may cross it again.

# %%
made = load_dict(scene())
for name, effect in made.integrator().context.effects.as_dict().items():
    print("on " if effect["on"] else "off", name.replace("_", " ") + ":", effect["why"])

# %% [markdown]
# ## Noise
#
# Collisions are drawn, so pictures have noise, which falls with the square root of the paths a pixel.

# %%
pictures = {spp: np.array(mi.render(made, spp=spp, seed=mi.UInt32(spp))) for spp in (1, 4, 16)}
figure, axes = plt.subplots(1, 3, figsize=(11, 4))
for axis, (spp, image) in zip(axes, pictures.items(), strict=True):
    axis.imshow(shown(image))
    axis.set_title(f"{spp} paths a pixel")
    axis.axis("off")
assert all(np.isfinite(image).all() for image in pictures.values())
# %% [markdown]
# ## Density by a grid, or by the network
#
# Where light is scattered is decided by the density. It was baked into a grid, which paths read without a filter: the pixel's
# paths average what a filter would. The network at every sample, filtered, is slower.

# %%
figure, axes = plt.subplots(1, 2, figsize=(8, 4))
for axis, density in zip(axes, ("baked", "network"), strict=True):
    way = load_dict(scene(), PRESETS["normal"].with_changes(density=density))
    np.array(mi.render(way, spp=16))  # compiles
    begin = time.perf_counter()
    axis.imshow(shown(np.array(mi.render(way, spp=16))))
    axis.set_title(f"{density}: {time.perf_counter() - begin:.1f} s for 16 paths a pixel")
    axis.axis("off")

# %% [markdown]
# ## Light straight from its sources
#
# With one shell on a convex mesh over dark ground and distant lights alone, nothing is drawn: all samples of a ray are summed.
# On the cow, which can shade itself, collisions are drawn all the same; how many samples a ray has is a field of `Quality`.

# %%
sun = {"type": "directional", "direction": [-0.5, -0.8, 0.6], "irradiance": 9.0}
coarse, fine = (PRESETS["draft"].with_changes(samples=n) for n in (8, 32))
figure, axes = plt.subplots(1, 2, figsize=(8, 4))
for axis, (name, quality) in zip(axes, {"8 samples a ray": coarse, "32": fine}.items(), strict=True):
    lit = load_dict(scene(sky=sun, integrator={"type": "path", "max_depth": 2}), quality)
    image = np.array(mi.render(lit, spp=8))
    axis.imshow(shown(image))
    axis.set_title(f"{name}: {lit.integrator().context.queries / SIZE**2 / 8:.1f} decoded a path")
    axis.axis("off")
