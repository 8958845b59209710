"""Exemplars for a generator: scaled, and as rows of a step.

Notation
K           exemplars (io/exemplars)
f, F        a channel as it was fitted, and scaled: F = (f − mean)/deviation
B           rows a step
S           texels along a side of a row: of a patch, or of a window for a critic

The scale of the channels goes into the decoder's first layer, and into F(h): the decoder's output stays the same.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.exemplars import Exemplars
from mesoshell.nets.mlp import Dense
from mesoshell.shell.material.decoder import Decoder
from mesoshell.shell.material.loader import decoder_of


class ExemplarBatch(NamedTuple):
    """Rows of a step. patch, feature, beta: an exemplar, to reproduce at its own phases, or a window of it, for a critic;
    key: for phases of a new texture, and lights. NumPy on the host."""

    patch: Any  # (B,)
    feature: Any  # (B, S, S, C)
    beta: Any  # (B, G)
    key: Any  # (B, 2), uint32


@dataclass(frozen=True, eq=False)
class ScaledExemplars:
    """Exemplars of zero mean and unit variance a channel, with the decoder adapted to them. what: as they were read, without
    fixed parameters."""

    what: Exemplars
    features: Float[np.ndarray, "K H H C"]
    height: Float[np.ndarray, "R C"]
    decoder: Decoder

    @property
    def folder(self) -> Path:
        return self.what.folder

    @property
    def recipe(self) -> str:
        return self.what.recipe

    @property
    def manifest(self) -> dict[str, Any]:
        return self.what.manifest

    @property
    def alphas(self) -> int:
        """How many appearance parameters the decoder takes."""
        return sum(p.role == "alpha" for p in self.what.parameters)


def scale_exemplars(exemplars: Exemplars, coarser: int = 1) -> ScaledExemplars:
    """Exemplars at unit variance a channel. coarser: texels along a side that one of theirs stands for: the mean of these."""
    k, h, _, c = exemplars.features.shape
    f = exemplars.features.astype(np.float32)
    f = f.reshape(k, h // coarser, coarser, h // coarser, coarser, c).mean(axis=(2, 4))
    mean, deviation = f.mean(axis=(0, 1, 2)), np.maximum(f.std(axis=(0, 1, 2)), 1e-6)
    decoder = decoder_of(exemplars.decoder)
    kernel, bias = (np.asarray(x) for x in decoder.trunk[0])
    c = len(mean)
    wider = jnp.asarray(np.concatenate([kernel[:c] * deviation[:, None], kernel[c:]]))
    decoder = decoder._replace(trunk=[Dense(wider, jnp.asarray(bias + mean @ kernel[:c])), *decoder.trunk[1:]])
    return ScaledExemplars(exemplars, (f - mean) / deviation, exemplars.height.astype(np.float32) / deviation, decoder)


def feed(config: Any, data: ScaledExemplars, host: int = 0, hosts: int = 1) -> Callable[[int], ExemplarBatch]:
    """This host's rows of step i: exemplars in a new order each pass, or windows at random for a critic. Raises InputError if
    hosts cannot share the batch."""
    if config.batch % hosts:
        raise InputError("batch", f"{config.batch} is no multiple of the {hosts} hosts")
    rows, count = config.batch // hosts, len(data.features)

    def at(step: int) -> ExemplarBatch:
        mine = slice(host * rows, (host + 1) * rows)
        drawn = np.random.default_rng([config.seed % 2**32, step, 1])
        keys = drawn.integers(0, 2**32, (config.batch, 2), np.uint32)[mine]
        if config.adversarial:
            patch = drawn.integers(count, size=config.batch)[mine]
            corners = drawn.integers(data.features.shape[1], size=(config.batch, 2))[mine]
            feature = np.stack(
                [_window(data.features[k], c, config.window) for k, c in zip(patch, corners, strict=True)]
            )
        else:
            places = np.arange(step * config.batch, (step + 1) * config.batch)
            order = {
                n: np.random.default_rng([config.seed % 2**32, n]).permutation(count)
                for n in np.unique(places // count)
            }
            patch = np.array([order[n // count][n % count] for n in places])[mine]
            feature = data.features[patch]
        return ExemplarBatch(patch.astype(np.int32), feature, data.what.beta[patch], keys)

    return at


def _window(f: Float[np.ndarray, "H H C"], corner: np.ndarray, side: int) -> Float[np.ndarray, "S S C"]:
    """A window of a texture that wraps around."""
    v, u = (np.arange(c, c + side) % len(f) for c in corner)
    return f[v[:, None], u[None]]
