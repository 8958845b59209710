"""What a fit keeps on the way: the textures that it has with their decoder, and pictures that it was not shown beside renders.

Alphabet
y           x / (1 + x) of radiance, and alpha
foreground  pixels whose true alpha exceeds 0.5
sheet       a column a patch: its nearest held-out picture as fitted, over the render
"""

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.checkout import commit
from mesoshell.io.exemplars import Exemplars, write_exemplars
from mesoshell.io.sheet import tiled
from mesoshell.shell.field import Material
from mesoshell.texture import mip
from mesoshell.train.export import declared, decoder_arrays
from mesoshell.train.fit import FitConfig, FitState, predict
from mesoshell.train.shots import Rays, Shots, rays_at

COLUMNS = 12
_RAYS = 1024


def exemplars(config: FitConfig, shots: Shots, state: FitState) -> Exemplars:
    """What was fitted, as it is written."""
    provenance = {"config": asdict(config), "steps": int(state.step), "commit": commit()}
    provenance["datasets"] = shots.origins
    return Exemplars(
        np.asarray(state.own.feature),
        np.asarray(state.common.height)[:, 0],
        shots.beta,
        decoder_arrays(state.common.decoder),
        config.octaves,
        declared(shots.manifest),
        provenance,
    )


def save(path: Path, config: FitConfig, shots: Shots, state: FitState) -> None:
    write_exemplars(path, exemplars(config, shots, state))


def sheet(config: FitConfig, shots: Shots, state: FitState) -> Float[np.ndarray, "h w 3"]:
    """The nearest held-out picture of up to COLUMNS patches, fitted over rendered; learned ones where none are held out."""
    patches = np.unique(np.linspace(0, config.patches - 1, COLUMNS).round().astype(int))
    pairs = []
    for k in patches:
        pixels = shots.held[k] if len(shots.held[k]) else shots.learned[k]
        n = np.unique(np.searchsorted(shots.first, pixels, side="right") - 1)
        nearest = min(n, key=lambda i: shots.samples[i].radius)
        pairs.append(picture_pair(config, shots, state, int(k), int(nearest)))
    shown = np.stack([np.stack(side) for side in zip(*pairs, strict=True)]).reshape(-1, *pairs[0][0].shape)
    return np.asarray(tiled(shown[..., :3], len(patches)))


def picture_pair(config: FitConfig, shots: Shots, state: FitState, patch: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Picture n as fitted and as rendered, y of every pixel, (H, W, 4) each."""
    pixels = np.arange(shots.first[n], shots.first[n + 1])
    among = np.concatenate([shots.learned[patch], shots.held[patch]])
    hits = np.intersect1d(pixels, among)
    y = np.zeros((len(pixels), 4), np.float32)
    y[hits - shots.first[n]] = predicted(config, shots, state, patch, hits)
    colour = shots.pixels[pixels].astype(np.float32)
    true = np.concatenate([colour[:, :3] / (1 + colour[:, :3]), colour[:, 3:]], axis=1)
    width, height = shots.samples[n].size
    return y.reshape(height, width, 4), true.reshape(height, width, 4)


def predicted(
    config: FitConfig, shots: Shots, state: FitState, patch: int, pixels: np.ndarray
) -> Float[np.ndarray, "R 4"]:
    """y of some pixels of a patch's pictures."""
    material = Material(
        mip.pack(mip.build(state.own.feature[patch])), mip.pack(mip.build(state.common.height)), state.common.decoder
    )
    out = np.zeros((len(pixels), 4), np.float32)
    for begin in range(0, len(pixels), _RAYS):
        some = pixels[begin : begin + _RAYS]
        row = rays_at(shots, np.resize(some, _RAYS), patch, np.zeros(2, np.uint32))
        out[begin : begin + _RAYS] = np.asarray(_row(config, material, row))[: len(some)]
    return out


@partial(jax.jit, static_argnums=0)
def _row(config: FitConfig, material: Material, row: Rays) -> jax.Array:
    everything = jnp.full((32, 8, 8), jnp.inf)
    middle = jnp.full((_RAYS, config.candidates), 0.5)
    return predict(replace(config, decoded=1.0), material, row, everything, middle)[0]


def scores(config: FitConfig, shots: Shots, state: FitState) -> list[dict[str, Any]]:
    """PSNR of each patch's held-out pictures, dB: foreground's y, and alpha of all that meets the box."""
    found = []
    for k, pixels in enumerate(shots.held):
        y = predicted(config, shots, state, k, pixels)
        true = rays_at(shots, pixels, k, np.zeros(2, np.uint32)).target
        front = true[:, 3] > 0.5
        colour = np.mean((y[front, :3] - true[front, :3]) ** 2)
        alpha = np.mean((y[:, 3] - true[:, 3]) ** 2)
        found.append({"foreground": float(-10 * np.log10(colour)), "alpha": float(-10 * np.log10(alpha))})
    return found


def painter(config: FitConfig, path: Path) -> Callable[[Any], Any]:
    raise InputError(path, "is of a fit, which scores its own held-out pictures")
