"""A figure: pictures in rows and columns, with a title a column and a name a row."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mesoshell.io.image import linear_to_srgb

#: Folder of the figures.
OUT = Path("out/figures")


def over_white(rgba: Float[np.ndarray, "H W 4"]) -> Float[np.ndarray, "H W 3"]:
    """A linear, premultiplied picture as it is shown: sRGB."""
    return linear_to_srgb(np.clip(rgba[..., :3] + 1 - rgba[..., 3:], 0, 1))


def draw(
    name: str,
    rows: Sequence[Sequence[np.ndarray]],
    titles: Sequence[str] = (),
    names: Sequence[str] = (),
    wide: float = 2.4,
) -> Path:
    """Write out/figures/NAME.png, and return its path. rows: pictures, (H, W) or sRGB; wide: inches of a column."""
    from matplotlib.figure import Figure

    high = sum(wide * row[0].shape[0] / row[0].shape[1] + 0.3 for row in rows)
    figure = Figure(figsize=(wide * len(rows[0]) + 0.4 * bool(names), high), dpi=130, layout="constrained")
    axes = figure.subplots(len(rows), len(rows[0]), squeeze=False)
    for i, row in enumerate(rows):
        for j, picture in enumerate(row):
            axes[i, j].imshow(picture, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
            axes[i, j].set(xticks=[], yticks=[])
            axes[i, j].spines[:].set_visible(False)
    for axis, title in zip(axes[0], titles, strict=bool(titles)):
        axis.set_title(title, fontsize=9)
    for axis, text in zip(axes[:, 0], names, strict=bool(names)):
        axis.set_ylabel(text, fontsize=9)
    OUT.mkdir(parents=True, exist_ok=True)
    path = OUT / f"{name}.png"
    figure.savefig(path)
    print(path)
    return path
