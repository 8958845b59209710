"""What a fit of patches depends on, and what it holds while it is under way.

Notation
K, G        patches; patches a step
B, R        rows a step, each of rays of one patch; rays a row
D, V, U     layers, rows and columns of an occupancy: largest recent σ in each cell of (h, v, u) of a patch
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import optax

from mesoshell.io.exemplars import Exemplars
from mesoshell.shell.material.decoder import Decoder
from mesoshell.shell.material.field import Layout, Material
from mesoshell.shell.material.loader import decoder_of
from mesoshell.texture import mip
from mesoshell.typing import Array, Bool, Float, Int, Scalar


@dataclass(frozen=True)
class FitConfig:
    """Everything that a fit depends on beside the data. batch, rays: B, R; group: most patches a step; decoded: share of
    its candidates that a row may decode; rates fall to `final` of themselves; patches, appearance: K, and the number of α,
    which follow from the data, as tiles does: patches along the side of a torus, 0 where each is one of its own; kept: steps
    between snapshots; given: a material or exemplars whose decoder and F(h) are kept fixed; given_digest: of that file; held:
    held-out pictures of each patch, in each dataset."""

    texels: int = 256
    channels: int = 32
    height_rows: int = 64
    octaves: int = 4
    trunk: tuple[int, ...] = (64, 64, 64)
    head: tuple[int, ...] = (64, 64)
    batch: int = 8
    rays: int = 256
    group: int = 4
    candidates: int = 96
    decoded: float = 0.45
    rate: float = 1e-2
    texture_rate: float = 3e-2
    final: float = 0.02
    stand: float = 0.1
    settle: float = 0.7
    steps: int = 4000
    kept: int = 1000
    patches: int = 1
    appearance: int = 0
    tiles: int = 0
    given: str = ""
    given_digest: str = ""
    held: int = 0
    seed: int = 0

    @property
    def kimg(self) -> float:
        """Length of the run, thousands of rows."""
        return self.steps * self.batch / 1000

    @property
    def snapshot_kimg(self) -> float:
        return self.kept * self.batch / 1000

    @property
    def at_once(self) -> int:
        """G, a divisor of the rows of a step."""
        return max(g for g in range(1, min(self.group, self.patches) + 1) if self.batch % g == 0)

    @property
    def together(self) -> int:
        """Consecutive rows of a step that show one patch."""
        return self.batch // self.at_once

    @property
    def side(self) -> int:
        """Texels along the side of a texture."""
        return self.texels * max(self.tiles, 1)

    @property
    def layout(self) -> Layout:
        sizes, rows = mip.level_sizes(self.side, self.side), mip.level_sizes(self.height_rows, 1)
        return Layout(sizes, rows, float(self.texels), self.octaves, period=max(self.tiles, 1))


class Common(NamedTuple):
    """Parameters that all patches share. height: F(h)."""

    height: Float[Array, "R 1 C"]
    decoder: Decoder


class Own(NamedTuple):
    """State of each texture, of a patch or of a torus: F(u, v), its Adam state, and its occupancy."""

    feature: Float[Array, "K H W C"]
    adam: Any
    occupancy: Float[Array, "K D V U"]


class FitState(NamedTuple):
    """A fit under way; a pytree of arrays. images: rows seen."""

    common: Common
    common_adam: optax.OptState
    own: Own
    step: Int[Array, ""]
    images: Int[Array, ""]


class FitReport(NamedTuple):
    """Mean squared error; occupied candidates over the decoding budget; which leaves of the gradients are not finite."""

    error: Scalar
    wanted: Scalar
    bad: Bool[Array, "_leaves"]


def material_of(common: Common, feature: Float[Array, "H W C"]) -> Material:
    """The material of one texture."""
    return Material(mip.pack(mip.build(feature)), mip.pack(mip.build(common.height)), common.decoder)


def texture_of(config: FitConfig, state: FitState, patch: int) -> Float[Array, "H W C"]:
    """The texture that holds a patch."""
    return state.own.feature[0 if config.tiles else patch]


def given(exemplars: Exemplars) -> Callable[[int], Material]:
    """The material of each patch of stored exemplars."""
    height = jnp.asarray(exemplars.height, jnp.float32)[:, None]
    common = Common(height, decoder_of(exemplars.decoder))
    return lambda k: material_of(common, jnp.asarray(exemplars.features[k], jnp.float32))
