"""How well a fit predicts held-out images.

Notation
y           x / (1 + x) of radiance, and alpha, with peak 1: the scores compare these
foreground  pixels whose true alpha exceeds 0.5
blocks      means over 4 × 4 pixels: the picture as seen from afar
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.measure.image import psnr, psnr_blocks, psnr_masked, ssim
from mesoshell.shell.material.field import Material
from mesoshell.train.fit.patch_rays import FitData, Rays, rays_at
from mesoshell.train.fit.slab_pixels import predict
from mesoshell.train.fit.state import FitConfig

#: The material of each patch.
MaterialOfPatch = Callable[[int], Material]
#: Rays a call, and candidate samples a ray: more of them do not change the scores.
_RAYS, _CANDIDATES = 1024, 96


class Scores(NamedTuple):
    """In dB, except ssim and mean, which is the predicted radiance of all pixels over the true one, less 1. constant:
    foreground of the best single colour in the true mask, the lowest useful score."""

    foreground: float
    alpha: float
    blocks: float
    ssim: float
    constant: float
    mean: float


def score(
    config: FitConfig, data: FitData, fitted: MaterialOfPatch, folder: Path
) -> tuple[Scores, Float[np.ndarray, "N H W 4"]]:
    """Scores over all held-out pictures of a dataset, and their predictions, patch by patch."""
    some = held_pictures(data, folder)
    pictures, true = (
        np.stack(x) for x in zip(*(picture_pair(config, data, fitted(k), k, n) for k, n in some), strict=True)
    )
    return compare(pictures, true), pictures


def held_pictures(data: FitData, folder: Path) -> list[tuple[int, int]]:
    """(Patch, picture) of a dataset's held-out pictures."""
    by_patch = (np.unique(np.searchsorted(data.first, p, side="right") - 1) for p in data.held)
    of = [(k, int(n)) for k, pictures in enumerate(by_patch) for n in pictures]
    return [(k, n) for k, n in of if data.samples[n].file.parents[1] == folder]


def picture_pair(
    config: FitConfig, data: FitData, material: Material, patch: int, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """Picture n as fitted and as rendered, y of every pixel, (H, W, 4) each."""
    pixels = np.arange(data.first[n], data.first[n + 1])
    hits = np.intersect1d(pixels, np.concatenate([data.learned[patch], data.held[patch]]))
    y = np.zeros((len(pixels), 4), np.float32)
    y[hits - data.first[n]] = predict_pixels(config, data, material, patch, hits)
    width, height = data.samples[n].size
    return y.reshape(height, width, 4), data.target(pixels).reshape(height, width, 4)


def predict_pixels(
    config: FitConfig, data: FitData, material: Material, patch: int, pixels: np.ndarray
) -> Float[np.ndarray, "R 4"]:
    """y of some pixels of a patch's pictures."""
    out = np.zeros((len(pixels), 4), np.float32)
    for begin in range(0, len(pixels), _RAYS):
        some = pixels[begin : begin + _RAYS]
        row = rays_at(data, np.resize(some, _RAYS), patch, np.zeros(2, np.uint32))
        out[begin : begin + _RAYS] = np.asarray(_row(config, material, row))[: len(some)]
    return out


@partial(jax.jit, static_argnums=0)
def _row(config: FitConfig, material: Material, row: Rays) -> jax.Array:
    everywhere, middle = jnp.full((1, 1, 1), jnp.inf), jnp.full((_RAYS, _CANDIDATES), 0.5)
    return predict(config.layout, 1.0, material, row, everywhere, middle)[0]


def compare(pictures: Float[np.ndarray, "N H W 4"], truth: Float[np.ndarray, "N H W 4"]) -> Scores:
    """Scores of predicted y against true y; NaN where nothing is opaque, or nothing gives light."""
    y, true = _tall(pictures), _tall(truth)
    mask = true[..., 3] > 0.5
    within = partial(psnr_masked, b=true[..., :3], mask=mask) if mask.any() else lambda a: np.nan
    mean = true[mask][:, :3].mean(axis=0) if mask.any() else np.zeros(3)
    return Scores(
        foreground=within(y[..., :3]),
        alpha=psnr(y[..., 3:], true[..., 3:]),
        blocks=psnr_blocks(y[..., :3], true[..., :3], 4),
        ssim=float(np.mean([ssim(a[..., :3], b[..., :3]) for a, b in zip(pictures, truth, strict=True)])),
        constant=within(np.broadcast_to(mean, true[..., :3].shape).astype(np.float32)),
        mean=_radiance(y) / _radiance(true) - 1 if _radiance(true) else np.nan,
    )


def _tall(y: Float[np.ndarray, "N H W 4"]) -> Float[np.ndarray, "M W 4"]:
    """All images one below the other."""
    return y.reshape(-1, *y.shape[2:])


def _radiance(y: Float[np.ndarray, "... 4"]) -> float:
    """Summed radiance of all pixels."""
    colour = y[..., :3].astype(np.float64)
    return float((colour / (1 - colour)).sum())
