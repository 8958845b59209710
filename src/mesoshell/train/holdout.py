"""How well a fit predicts images that it has not seen.

Alphabet
y           x / (1 + x) of radiance, and alpha: what is compared, peak 1
foreground  pixels whose true alpha exceeds 0.5
blocks      means over 4 × 4 pixels: how well the picture is right from afar
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.io.dataset import Dataset, load_images
from mesoshell.measure.image import psnr, psnr_blocks, psnr_masked, ssim
from mesoshell.train.fit import Batch, FitConfig, State, predict
from mesoshell.train.rays import RayTable, image_table, ray_table

#: Rays a call, and candidate samples a ray: enough that more do not change the figures.
_RAYS, _CANDIDATES = 1024, 96


class Scores(NamedTuple):
    """dB, except ssim and mean: predicted radiance of all pixels over the true, less 1. constant: foreground of the best single
    colour in the true mask, the floor of the scale."""

    foreground: float
    alpha: float
    blocks: float
    ssim: float
    constant: float
    mean: float


def predict_images(config: FitConfig, state: State, dataset: Dataset, table: RayTable) -> Float[np.ndarray, "N H W 4"]:
    """y of every pixel of every image of a dataset."""
    images = image_table(dataset)
    light, irradiance, alpha = (jnp.asarray(x) for x in images)
    dense = replace(config, candidates=_CANDIDATES, decoded=1.0)

    @jax.jit
    def some(rays: RayTable) -> jax.Array:
        batch = Batch(rays, light[rays.image], irradiance[rays.image], alpha[rays.image])
        middle = jnp.full((_RAYS, _CANDIDATES), 0.5)
        return predict(dense, state.parameters, batch, state.occupancy, middle)[0]

    width, height = dataset.samples[0].size
    out = np.zeros((len(dataset.samples) * height * width, 4), np.float32)
    for begin in range(0, len(table.image), _RAYS):
        part = RayTable(*(x[begin : begin + _RAYS] for x in table))
        count = len(part.image)
        full = RayTable(*(np.concatenate([x, np.repeat(x[-1:], _RAYS - count, axis=0)]) for x in part))
        pixel = part.image.astype(np.int64) * height * width + part.pixel
        out[pixel] = np.asarray(some(full))[:count]
    return out.reshape(-1, height, width, 4)


def score(config: FitConfig, state: State, dataset: Dataset) -> tuple[Scores, Float[np.ndarray, "N H W 4"]]:
    """Scores over all images of a held-out dataset, and the predictions."""
    truth = load_images(dataset)
    truth = np.concatenate([truth[..., :3] / (1 + truth[..., :3]), truth[..., 3:]], axis=-1)
    found = predict_images(config, state, dataset, ray_table(dataset))
    return compare(found, truth), found


def compare(found: Float[np.ndarray, "N H W 4"], truth: Float[np.ndarray, "N H W 4"]) -> Scores:
    """Scores of predicted y against true y."""
    y, true = _tall(found), _tall(truth)
    mask = true[..., 3] > 0.5
    flat = np.broadcast_to(true[mask][:, :3].mean(axis=0), true[..., :3].shape).astype(np.float32)
    return Scores(
        foreground=psnr_masked(y[..., :3], true[..., :3], mask),
        alpha=psnr(y[..., 3:], true[..., 3:]),
        blocks=psnr_blocks(y[..., :3], true[..., :3], 4),
        ssim=float(np.mean([ssim(a[..., :3], b[..., :3]) for a, b in zip(found, truth, strict=True)])),
        constant=psnr_masked(flat, true[..., :3], mask),
        mean=_radiance(y) / _radiance(true) - 1,
    )


def _tall(y: Float[np.ndarray, "N H W 4"]) -> Float[np.ndarray, "M W 4"]:
    """All images one below the other."""
    return y.reshape(-1, *y.shape[2:])


def _radiance(y: Float[np.ndarray, "... 4"]) -> float:
    """Of all pixels together."""
    colour = y[..., :3].astype(np.float64)
    return float((colour / (1 - colour)).sum())
