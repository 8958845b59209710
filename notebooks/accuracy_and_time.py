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
# # What accuracy costs in time, and what is hard about a scene
#
# A cow of grass is rendered up to a budget and to an error, its settings are measured against a reference, and its shell is
# walked by rays that are hard. (Small pictures and six seconds of measurements here; more in `docs/how_to/tradeoff.md`.)

# %%
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

import mesoshell as ms

folder = Path(tempfile.mkdtemp())
view = (1.5, 0.9, -2.4, 0, 0.05, 0.15, 40)
scene = ms.Scene("src/mesoshell/assets/spot.obj", ms.load_material("grass"), camera=view, size=(40, 40))

# %% [markdown]
# ## Up to a budget, or an error
#
# Pictures are made pass by pass. What was promised, what was reached and the settings that were chosen for it are in the
# report; seconds are those of the render loop, without set-up and compiling. An error is FLIP: what is expected of the settings
# themselves (bias), which more passes do not take away, beside what the passes tell of their noise.

# %%
goals = ({"budget": 1.0}, {"error": 0.06})
pictures = [ms.render(scene, **goal) for goal in goals]
figure, axes = plt.subplots(1, 2, figsize=(6, 3.4))
for axis, picture in zip(axes, pictures, strict=True):
    reached = picture.report["goal"]
    print({name: reached[name] for name in ("met", "noise", "bias", "settings")})
    picture.save(folder / "picture.png")
    axis.imshow(plt.imread(folder / "picture.png"))
    axis.set_title(f"{reached['samples']['mean']:.1f} rays a pixel, {reached['seconds']:.1f} s")
    axis.axis("off")

# %% [markdown]
# ## The front of this scene
#
# Every setting alone beside the presets, and what a model of the points so far expects most of, for as long as it is given. A
# later call goes on. `report.html` in the folder shows the pictures along the front, and what each setting buys.

# %%
measured = ms.tradeoff(replace(scene, size=(16, 16)), folder / "tradeoff", minutes=0.1)
seconds, errors = zip(*((entry.seconds, entry.flip) for entry in measured.front), strict=True)
plt.loglog(seconds, errors, "o-")
plt.xlabel("seconds")
plt.ylabel("error, mean FLIP")
plt.show()

# %% [markdown]
# ## What is hard
#
# A line a check: what was tried, the worst that was found, and the limit. The map shows where the shell keeps less than its
# thickness, and where places are off.

# %%
stability = ms.stability(scene, rays=2000)
print(stability)
assert not stability.broken
stability  # noqa: B018
