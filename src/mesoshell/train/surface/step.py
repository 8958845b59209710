"""Learning a surface material from traced queries.

Notation
B            queries a step
x            π ρ: 1 for a white diffuse surface that faces the light
blur         standard deviation of the blur of all textures, texels: from WIDE to `fine` over SHRINK of the run, geometrically
fine         final blur: 0.1 texels, or as wide as a square of MIN_QUERIES queries; a narrower blur would fit their noise
loss         mean over rays that hit of (log(1 + x) − log(1 + x̂))² + 0.1 |x − x̂|; of α, cross-entropy, or of the
             silhouette cosine, its squared error

The modules of opacity and of reflectance share no weights, and Adam does not depend on scale: their losses are added as they
are. Rates fall along a cosine to SLOWEST of their first value: at a constant rate, the finest texels stay grainy. The offset is
frozen from FREEZE of the run on, so that the reflectance's texture can converge at its places.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from mesoshell.errors import InputError
from mesoshell.io.query_dataset import COLUMNS, Patches
from mesoshell.surface_material.network import (
    OpacityEval,
    Surface,
    SurfaceConfig,
    SurfaceQuery,
    blur_textures,
    eval_opacity,
    init_surface,
    reflectance,
)
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.update import HERE, Across, descent, not_finite
from mesoshell.typing import Array, Bool, Float, Int, Key, Scalar

WIDE, SHRINK, FREEZE = 8.0, 0.6, 0.8
#: Queries in the square of `fine`, and its bounds, texels. With 128 queries a texel, blurs of 1 and of 0.1 left a squared error
#: of 4.9% and 6.1% on held-out queries.
MIN_QUERIES, FINE, COARSE = 128, 0.1, 1.0
SLOWEST = 0.02
#: Patches that a step draws queries from; one in HELD patches, from the end, is held out.
MIXED, HELD = 64, 32


@dataclass(frozen=True)
class SurfaceTrainConfig:
    """Everything that a run depends on beside the data. batch: B; kimg: thousands of queries to learn from; curvature: the
    range of the dataset's κ; fine: the least blur; both follow from the dataset."""

    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    batch: int = 16384
    kimg: float = 16384 * 30.0
    rate: float = 1e-3
    texture_rate: float = 1e-2
    snapshot_kimg: float = 16384 * 3.0
    seed: int = 0
    curvature: tuple[float, float] = (-1.0, 1.0)
    fine: float = FINE


class QueryBatch(NamedTuple):
    """A batch of queries with their answers; the columns of io/query_dataset."""

    u: Float[Array, "B 2"]
    radius: Float[Array, "B"]
    w: Float[Array, "B 3"]
    kappa: Float[Array, "B"]
    light: Float[Array, "B 3"]
    alpha: Float[Array, "B"]
    cosine: Float[Array, "B"]
    rgb: Float[Array, "B 3"]


class SurfaceState(NamedTuple):
    """A run under way; a pytree of arrays. images: queries seen."""

    surface: Surface
    adam: optax.OptState
    step: Int[Array, ""]
    images: Int[Array, ""]


class SurfaceReport(NamedTuple):
    """Parts of the loss, and which leaves of the gradient are not finite."""

    reflectance: Scalar
    opacity: Scalar
    bad: Bool[Array, "_leaves"]


def surface_config(preset: GanConfig, hidden: tuple[int, ...] = SurfaceConfig.hidden) -> SurfaceTrainConfig:
    """A run at a preset's size: `small` and above are 30 000 steps, `mini` 6000, `tiny` is over in a minute and has networks
    of its own. hidden: their layers."""
    if preset.picture.texels < 32:
        return SurfaceTrainConfig(SurfaceConfig(32, hidden=(16, 16)), batch=1024, kimg=200 * 1.024, snapshot_kimg=102.4)
    surface = SurfaceConfig(hidden=hidden)
    return SurfaceTrainConfig(surface) if preset.picture.texels > 32 else SurfaceTrainConfig(surface, kimg=16384 * 6.0)


def adapt(config: SurfaceTrainConfig, data: Patches) -> tuple[SurfaceTrainConfig, Patches]:
    """The configuration adapted to a dataset. Raises InputError if it has too few patches, no curvature or no depth."""
    if len(data.patches) < 2:
        raise InputError(data.folder, f"has {len(data.patches)} patch: one is held out, others are learned from")
    try:
        low, high = (float(x) for x in data.manifest["curvature"])
        known = low < high and float(data.manifest["depth"]) > 0
    except (KeyError, TypeError, ValueError):
        known = False
    if not known:
        raise InputError(data.folder / "manifest.json", "has no range of curvature, or no depth")
    each = sum(len(rows) for rows in held_out(data)[0]) / config.surface.texels**2
    return replace(config, curvature=(low, high), fine=float(np.clip((MIN_QUERIES / each) ** 0.5, FINE, COARSE))), data


def held_out(data: Patches) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Patches to learn from, and patches to test with."""
    last = max(1, len(data.patches) // HELD)
    return data.patches[:-last], data.patches[-last:]


def feed(config: SurfaceTrainConfig, data: Patches, host: int = 0, hosts: int = 1) -> Callable[[int], "QueryBatch"]:
    """This host's queries of step i: equal runs of consecutive queries from patches drawn for the step. Raises InputError if
    they cannot be divided evenly, or a patch is too small or holds NaN."""
    patches = held_out(data)[0]
    mixed = min(MIXED, config.batch)
    each = config.batch // mixed
    if config.batch % mixed or mixed % hosts:
        raise InputError("batch", f"{config.batch} queries do not come evenly from {mixed} patches for {hosts} hosts")
    least = min(len(rows) for rows in patches)
    if least < each:
        raise InputError(data.folder, f"has {least} queries in a patch; a step takes {each}")

    def at(step: int) -> QueryBatch:
        random = np.random.default_rng([config.seed, step])
        chosen, first = random.integers(len(patches), size=mixed), random.random(mixed)
        rows = []
        for k, share in list(zip(chosen, first, strict=True))[host::hosts]:
            begin = int(share * (len(patches[k]) - each + 1))
            rows.append(patches[k][begin : begin + each])
            if not np.isfinite(rows[-1]).all():
                raise InputError(data.folder, f"patch {k} has NaN or infinite numbers")
        return query_batch(np.concatenate(rows))

    return at


def query_batch(rows: np.ndarray) -> "QueryBatch":
    """Rows of patches as a QueryBatch."""
    column: dict[str, Any] = {name: np.ascontiguousarray(rows[:, i]) for i, name in enumerate(COLUMNS)}
    column |= {name: np.stack([column[c] for c in of], axis=-1) for name, of in _VECTORS.items()}
    return QueryBatch(**{name: column[name] for name in QueryBatch._fields})


#: Fields of QueryBatch that consist of several columns.
_VECTORS = {"u": ("u", "v"), "w": ("wx", "wy", "wz"), "light": ("lx", "ly", "lz"), "rgb": ("r", "g", "b")}


def start(config: SurfaceTrainConfig, key: Key[Array, ""]) -> SurfaceState:
    """A state before training."""
    surface = init_surface(config.surface, key)
    return SurfaceState(surface, optimiser(config).init(surface), jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32))


def step(
    config: SurfaceTrainConfig, state: SurfaceState, batch: QueryBatch, across: Across = HERE
) -> tuple[SurfaceState, SurfaceReport]:
    """One update. Pure."""
    share = state.images.astype(jnp.float32) / (config.kimg * 1000)

    def loss(surface: Surface) -> tuple[Scalar, tuple[Scalar, Scalar]]:
        opacity, rho = ask(config, surface, batch, blur_at(config, share))
        parts = _reflectance_loss(batch, rho), _opacity_loss(config, batch, opacity)
        return parts[0] + parts[1], parts

    (_, parts), gradient = jax.value_and_grad(loss, has_aux=True)(state.surface)
    parts, gradient = across.mean((parts, gradient))
    frozen = share > FREEZE
    updates, adam = descent(optimiser(config), state.surface, state.adam, gradient)
    updates: Any = updates._replace(offset=jax.tree.map(lambda x: jnp.where(frozen, 0, x), updates.offset))
    surface: Any = optax.apply_updates(state.surface, updates)
    bad = not_finite(gradient)
    rows = across.rows(batch.radius)
    return SurfaceState(surface, adam, state.step + 1, state.images + rows), SurfaceReport(parts[0], parts[1], bad)


def blur_at(config: SurfaceTrainConfig, share: Scalar) -> Scalar:
    """The blur of textures when this share of the run is done."""
    return WIDE * (config.fine / WIDE) ** jnp.clip(share / SHRINK, 0, 1)


def ask(
    config: SurfaceTrainConfig, surface: Surface, batch: QueryBatch, blur: Scalar
) -> tuple[OpacityEval, Float[Array, "B 3"]]:
    """A surface's answers to a batch: α and c, and ρ."""
    table = blur_textures(surface, blur)
    low, high = config.curvature
    kappa = (2 * batch.kappa - low - high) / (high - low)
    place = SurfaceQuery(batch.u, batch.radius, batch.w, kappa)
    opacity = jax.vmap(lambda p: eval_opacity(config.surface, table, p))(place)
    rho = jax.vmap(lambda p, s, l: reflectance(config.surface, table, p, s, l))(place, opacity, batch.light)
    return opacity, rho


def _reflectance_loss(batch: QueryBatch, rho: Float[Array, "B 3"]) -> Scalar:
    """The loss over rays that hit: a query counts by its α, the share of its rays that hit."""
    met = batch.alpha[:, None]
    wanted = jnp.pi * batch.rgb / jnp.maximum(met, 1e-3)
    x = jnp.pi * rho
    apart = (jnp.log1p(x) - jnp.log1p(wanted)) ** 2 + 0.1 * jnp.abs(x - wanted)
    return jnp.mean(met * apart)


def _opacity_loss(config: SurfaceTrainConfig, batch: QueryBatch, opacity: OpacityEval) -> Scalar:
    if config.surface.opacity == "none":
        return jnp.zeros((), batch.alpha.dtype)
    if config.surface.opacity == "cosine":
        return jnp.mean((opacity.cosine - batch.cosine) ** 2)
    p = jnp.clip(opacity.alpha, 1e-6, 1 - 1e-6)
    return -jnp.mean(batch.alpha * jnp.log(p) + (1 - batch.alpha) * jnp.log1p(-p))


def optimiser(config: SurfaceTrainConfig) -> optax.GradientTransformation:
    """Adam, with a rate of its own for textures."""

    def label(surface: Surface) -> Surface:
        def of(module: Any) -> Any:
            networks = jax.tree.map(lambda _: "network", (module.hidden, module.last))
            return type(module)(["texture"] * len(module.texture), *networks)

        return Surface(*(of(module) for module in surface))

    steps = max(1, round(config.kimg * 1000 / config.batch))
    rates = {"texture": config.texture_rate, "network": config.rate}
    falling = {name: optax.cosine_decay_schedule(rate, steps, SLOWEST) for name, rate in rates.items()}
    return optax.multi_transform({name: optax.adam(rate) for name, rate in falling.items()}, label)
