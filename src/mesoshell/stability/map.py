"""Where a scene is hard, as a picture: the scene, its shell's thickness, and the worst place of its walks.

Notation
excess      of each prism: the worst place of edges, prisms, crossings and precision, over what one may be off
"""

import io

import numpy as np
from jaxtyping import Float, Int

from mesoshell.io.image import linear_to_srgb
from mesoshell.scene.accumulate import over_backdrop

#: Least and greatest excess that are told apart.
MIN_EXCESS, MAX_EXCESS = 1e-4, 10.0


def png_of(
    picture: Float[np.ndarray, "H W 4"],
    first: Int[np.ndarray, "H W"],
    kept: Float[np.ndarray, "P"] | None,
    excess: Float[np.ndarray, "P"],
) -> bytes:
    """The map as a PNG file. picture, first, kept, excess: of `Stability` (stability/report)."""
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    high, wide = first.shape
    count = 2 if kept is None else 3
    figure = Figure(figsize=(4 * count, 12 / 3.3 * min(high / wide, 2) + 0.6), dpi=100, layout="constrained")
    panels = figure.subplots(1, count)
    panels[0].imshow(linear_to_srgb(np.clip(over_backdrop(np.nan_to_num(picture)), 0, 1)))
    panels[0].set_title("the scene", fontsize=10)
    if kept is not None:
        shares = panels[1].imshow(_where_visible(first, kept), cmap="viridis", vmin=0, vmax=1)
        panels[1].set_title("share of the thickness that is kept", fontsize=10)
        figure.colorbar(shares, ax=panels[1], shrink=0.8)
    over = panels[-1].imshow(
        _where_visible(first, np.clip(excess, MIN_EXCESS, MAX_EXCESS)),
        cmap="magma",
        norm=LogNorm(MIN_EXCESS, MAX_EXCESS),
    )
    panels[-1].set_title("how far off a place is, over what it may be", fontsize=10)
    figure.colorbar(over, ax=panels[-1], shrink=0.8)
    for panel in panels:
        panel.set_axis_off()
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _where_visible(first: Int[np.ndarray, "H W"], value: np.ndarray) -> np.ma.MaskedArray:
    """A value of each prism, at the pixels that see one."""
    return np.ma.masked_where(first < 0, value[np.maximum(first, 0)])
