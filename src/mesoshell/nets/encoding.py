"""Encodings of a point in space for a network.

Notation
y           a point of [−1, 1]³
frequency   (y, sin π2ᵏy, cos π2ᵏy …), k < octaves (NeRF, equation 4)
hash grid   L grids of growing resolution; a corner's features lie at its number in a table of 2ᴮ rows, or at a hash of it where
            there are more corners than rows; trilinear between corners; all levels side by side (Müller et al., Instant
            Neural Graphics Primitives, 2022, section 3)
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.typing import Array, Float, Int, Key, Vec3

#: Factors of the hash (Müller et al., equation 4).
PRIMES = (1, 2654435761, 805459861)
CORNERS = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(8, 3)


@dataclass(frozen=True)
class HashConfig:
    """levels: L, of resolutions in geometric progression from coarsest to finest; rows: B."""

    levels: int = 8
    features: int = 2
    rows: int = 15
    coarsest: int = 8
    finest: int = 128

    @property
    def resolutions(self) -> tuple[int, ...]:
        steps = max(1, self.levels - 1)
        return tuple(round(self.coarsest * (self.finest / self.coarsest) ** (i / steps)) for i in range(self.levels))

    @property
    def width(self) -> int:
        return self.levels * self.features


def frequency(y: Float[Array, "D"], octaves: int) -> Float[Array, "E"]:
    """E = D (1 + 2 octaves)."""
    angle = (jnp.pi * 2.0 ** jnp.arange(octaves, dtype=y.dtype))[:, None] * y[None, :]
    return jnp.concatenate([y, jnp.sin(angle).ravel(), jnp.cos(angle).ravel()])


def init_tables(config: HashConfig, key: Key[Array, ""]) -> Float[Array, "L R C"]:
    """Uniform within ±1e-4, as in the paper."""
    shape = config.levels, 2**config.rows, config.features
    return jax.random.uniform(key, shape, jnp.float32, -1e-4, 1e-4)


def encode_hash_grid(config: HashConfig, tables: Float[Array, "L R C"], y: Vec3) -> Float[Array, "E"]:
    """Features of a point, E = L·C. Points outside are clamped to the box."""
    resolution = jnp.asarray(config.resolutions, y.dtype)[:, None]
    place = (jnp.clip(y, -1, 1) + 1)[None] / 2 * resolution
    low = jnp.clip(jnp.floor(place), 0, resolution - 1)
    part = place - low
    corner = low.astype(jnp.int32)[:, None] + jnp.asarray(CORNERS[None], jnp.int32)
    share = jnp.prod(jnp.where(CORNERS[None] == 1, part[:, None], 1 - part[:, None]), axis=-1)
    features = tables[jnp.arange(config.levels)[:, None], _rows(config, corner)]
    return jnp.sum(features * share[..., None], axis=1).ravel()


def _rows(config: HashConfig, corner: Int[Array, "L 8 3"]) -> Int[Array, "L 8"]:
    rows, x = [], corner.astype(jnp.uint32)
    for level, n in enumerate(config.resolutions):
        i, j, k = (x[level, :, axis] for axis in range(3))
        if (n + 1) ** 3 <= 2**config.rows:
            row = (i * jnp.uint32(n + 1) + j) * jnp.uint32(n + 1) + k
        else:
            a, b, c = (jnp.uint32(p) for p in PRIMES)
            row = (i * a ^ j * b ^ k * c) & jnp.uint32(2**config.rows - 1)
        rows.append(row)
    return jnp.stack(rows).astype(jnp.int32)
