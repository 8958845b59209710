"""Learning an object from its photographs (NeuTex, sections 3.4 and 4.2).

Notation
B            rays a step (train/neutex/ray_batches)
I, T         colour and transmittance of a ray; M: its pixel's mask
render       Σ (sRGB(I) − sRGB(I_gt))² of linear colours, so the error is in the photographs' own values (equation 9)
cycle        Σ w ‖F_uv⁻¹(F_uv(y)) − y‖² (equation 12), from one sample a ray, drawn by w: the same mean at 1/N of the cost. It
             trains only the two maps, as w and y are held fixed
mask         (M − (1 − T))² (equation 13)
facing       `away` of reflectance (neutex/march): back faces are black, so without it dark paint would be learned as holes
chamfer      mean square distance from each of B points of a cloud to the nearest of B points of F_uv⁻¹'s surface, and back
phase        with a cloud, chamfer and render in the first `chamfer` of the run, and the others too unless `alone`; then render
             + cycle + mask; in the last `finish` only F_tex is trained (section 4.2: 50 000 steps of 550 000, then "until
             convergence")
grid         the greatest recent σ in each cell; a step evaluates one cell in EACH; cells below SPARSE are not sampled
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax

from mesoshell.errors import InputError
from mesoshell.nets.encoding import HashConfig
from mesoshell.neutex.capture import Capture, at_most
from mesoshell.neutex.field import (
    DENSITY,
    Field,
    FieldConfig,
    density,
    init_field,
    to_surface,
    to_texture,
)
from mesoshell.neutex.march import CELLS, dilate, march
from mesoshell.render.composite import encoded
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.neutex.ray_batches import Rays, held_out, rays_for
from mesoshell.train.update import HERE, Across, descent, not_finite
from mesoshell.typing import Array, Bool, Float, Int, Key, Scalar

#: Steps in which each cell of the grid is evaluated once; decay of a cell's σ at each; least σ that is sampled.
EACH, KEEP, SPARSE = 16, 0.9, 0.05
#: Share of the learning rates at the end of the run.
SLOWEST = 0.05


@dataclass(frozen=True)
class NeuTexTrainConfig:
    """Everything that a run depends on beside the data. side: of the pictures at most, pixels; samples: N; batch: B; kimg:
    thousands of rays; cycle, mask: weights a₁ and a₂; facing: weight; chamfer, finish: shares of the run; alone: cycle and
    mask wait until `chamfer` is over; cloud: whether there is one, which follows from the capture."""

    field: FieldConfig = field(default_factory=FieldConfig)
    side: int = 512
    samples: int = 256
    batch: int = 768
    kimg: float = 768 * 600.0
    rate: float = 5e-4
    table_rate: float = 1e-2
    cycle: float = 1.0
    mask: float = 1.0
    facing: float = 0.3
    chamfer: float = 0.1
    alone: bool = True
    finish: float = 0.1
    snapshot_kimg: float = 768 * 50.0
    seed: int = 0
    cloud: bool = False


class NeuTexState(NamedTuple):
    """A run under way; a pytree of arrays. images: rays seen."""

    field: Field
    adam: optax.OptState
    grid: Float[Array, "n n n"]
    step: Int[Array, ""]
    images: Int[Array, ""]


class NeuTexReport(NamedTuple):
    """Parts of the loss, before their weights, and which leaves of the gradient are not finite."""

    render: Scalar
    cycle: Scalar
    mask: Scalar
    chamfer: Scalar
    facing: Scalar
    bad: Bool[Array, "_leaves"]


def neutex_config(preset: GanConfig, encoding: Literal["frequency", "hash"] | None = None) -> NeuTexTrainConfig:
    """A run at a preset's size: `paper` as published, `small` for a CPU, `tiny` for a test of a minute. encoding: by default
    frequencies for `paper`, hash grids for the others. Maps as wide as the paper's fold at a rate that finishes in minutes: on
    a CPU they are narrower, and their cycle weighs ten times as much from the first step on (docs/results/capture.md)."""
    texels = preset.picture.texels
    if texels > 64:
        grids = FieldConfig((64,) * 2, (64,) * 2, encoding="hash", hash=HashConfig(16, 2, 19, 16, 1024))
        return NeuTexTrainConfig(grids if encoding == "hash" else FieldConfig())
    if encoding == "frequency":
        field = FieldConfig((96,) * 4, (96,) * 3, (64, 64), (128, 128), 32, octaves=(6, 6, 2))
    else:
        field = FieldConfig((64,) * 2, (64,) * 2, (64, 64), (128, 128), 32, "hash")
    small = NeuTexTrainConfig(field, side=128, samples=32, batch=1024, kimg=1024 * 4.0, rate=2e-3, snapshot_kimg=512.0)
    small = replace(small, cycle=10.0, alone=False)
    if texels > 16:
        return small
    field = replace(field, hash=HashConfig(levels=5, rows=12, finest=32))
    return replace(
        small, field=field, side=32, samples=24, batch=512, kimg=512 * 0.4, rate=3e-3, snapshot_kimg=512 * 0.2
    )


def adapt(config: NeuTexTrainConfig, capture: Capture) -> tuple[NeuTexTrainConfig, Capture]:
    """The configuration adapted to a capture, and the capture at the configured size. Raises InputError if reflectance is to be
    learned without a known flash, or no pixel shows the object at that size."""
    if config.field.colour == "reflectance":
        if capture.flash is None:
            raise InputError(
                capture.folder, "says no `flash`: reflectance is learned from photographs lit by the camera alone"
            )
        config = replace(config, field=replace(config.field, flash=capture.flash / capture.half**2))
    capture = at_most(capture, config.side)
    if not any((capture.masks[i] >= 0.5).any() for i in held_out(capture)[0]):
        raise InputError(capture.folder, f"at {config.side} pixels a side no pixel is half covered by the object")
    return replace(config, cloud=capture.points is not None), capture


def feed(config: NeuTexTrainConfig, capture: Capture, host: int = 0, hosts: int = 1) -> Callable[[int], Rays]:
    """This host's rays of step i. Raises InputError if hosts cannot share them evenly."""
    return rays_for(config.batch, config.seed, capture, host, hosts)


def start(config: NeuTexTrainConfig, key: Key[Array, ""]) -> NeuTexState:
    """A state before training."""
    field = init_field(config.field, key)
    grid = jnp.full((CELLS,) * 3, DENSITY, jnp.float32)
    return NeuTexState(field, optimiser(config).init(field), grid, jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32))


def step(
    config: NeuTexTrainConfig, state: NeuTexState, batch: Rays, across: Across = HERE
) -> tuple[NeuTexState, NeuTexReport]:
    """One update. Pure."""
    share = state.images.astype(jnp.float32) / (config.kimg * 1000)
    early = (share < config.chamfer) & config.cloud
    occupied = dilate(state.grid > SPARSE)
    key = jax.random.key(config.seed)

    def loss(field: Field) -> tuple[Scalar, tuple[Scalar, ...]]:
        parts = jax.vmap(lambda row: _ray(config, field, occupied, key, row))(batch)
        render, cycle, mask, facing = (jnp.mean(x) for x in parts)
        near = jax.lax.cond(early, lambda: _chamfer(field, batch, across), lambda: jnp.zeros(()))
        others = jnp.where(early & config.alone, 0, config.cycle * cycle + config.mask * mask)
        return render + others + config.facing * facing + near, (render, cycle, mask, near, facing)

    (_, parts), gradient = jax.value_and_grad(loss, has_aux=True)(state.field)
    parts, gradient = across.mean((parts, gradient))
    updates, adam = descent(optimiser(config), state.field, state.adam, gradient)
    last = share >= 1 - config.finish
    updates: Any = updates
    updates = updates._replace(
        **{
            part: jax.tree.map(lambda x: jnp.where(last, 0, x), getattr(updates, part))
            for part in ("sigma", "uv", "inverse")
        }
    )
    field: Any = optax.apply_updates(state.field, updates)
    bad = not_finite(gradient)
    grid = updated_grid(config, field, state.grid, state.step, key)
    rows = across.rows(batch.mask)
    after = NeuTexState(field, adam, grid, state.step + 1, state.images + rows)
    return after, NeuTexReport(*parts, bad=bad)


def updated_grid(
    config: NeuTexTrainConfig, field: Field, grid: Float[Array, "n n n"], step: Int[Array, ""], key: Array
) -> Array:
    """The grid after evaluating this step's cells, at a random point in each."""
    n = grid.shape[0]
    cells = jnp.arange(n**3 // EACH) * EACH + (step * 7) % EACH  # 7: neighbours are evaluated in different steps
    corner = jnp.stack(jnp.unravel_index(cells, (n, n, n)), axis=-1).astype(grid.dtype)
    place = corner + jax.random.uniform(jax.random.fold_in(key, step), corner.shape, grid.dtype)
    sigma = jax.vmap(lambda y: density(config.field, field, y)[0])(place * (2 / n) - 1)
    old = grid.ravel()
    return old.at[cells].set(jnp.maximum(KEEP * old[cells], sigma)).reshape(grid.shape)


def _ray(
    config: NeuTexTrainConfig, field: Field, occupied: Array, key: Array, row: Rays
) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Parts of the loss of one ray: render, cycle, mask (equations 9, 12 and 13) and facing. row: of a batch."""
    xi, pick = jax.random.split(jax.random.fold_in(key, row.noise))
    places = jax.random.uniform(xi, (config.samples,), row.o.dtype)
    marched = march(config.field, field, row.o, row.d, occupied, places)
    render = jnp.sum((encoded(marched.colour) - encoded(row.rgb)) ** 2)
    cycle = jnp.zeros((), row.o.dtype)
    if config.cycle and config.field.colour != "volume":
        w = jax.lax.stop_gradient(marched.w)
        through = jnp.cumsum(w)
        i = jnp.sum(through < jax.random.uniform(pick, (), row.o.dtype) * through[-1])
        y = jax.lax.stop_gradient(marched.y[jnp.minimum(i, config.samples - 1)])
        cycle = through[-1] * jnp.sum((to_surface(field, to_texture(field, y)) - y) ** 2)
    return render, cycle, (row.mask - (1 - marched.passed)) ** 2, marched.away


def _chamfer(field: Field, batch: Rays, across: Across) -> Scalar:
    """The chamfer loss of this device's rows, to the nearest points of all devices."""
    surface = jax.vmap(lambda u: to_surface(field, u))(batch.u)
    all_surface, all_points = surface, batch.point
    if across.everyone is not None:
        all_surface, all_points = across.everyone(surface)[0], across.everyone(batch.point)[0]

    def nearest(a: Array, b: Array) -> Scalar:
        squares = (
            jnp.sum(a**2, axis=1)[:, None] + jnp.sum(b**2, axis=1)[None] - 2 * jnp.matmul(a, b.T, precision="highest")
        )
        return jnp.mean(jnp.min(jnp.maximum(squares, 0), axis=1))

    return nearest(batch.point, all_surface) + nearest(surface, all_points)


def optimiser(config: NeuTexTrainConfig) -> optax.GradientTransformation:
    """Adam, with a rate of its own for hash tables, that falls over the run."""

    def label(field: Field) -> Field:
        def of(net: Any) -> Any:
            return jax.tree.map(lambda _: "network", net)._replace(tables=jax.tree.map(lambda _: "tables", net.tables))

        return Field(*(of(net) for net in field))

    steps = max(1, round(config.kimg * 1000 / config.batch))
    rates = {"tables": config.table_rate, "network": config.rate}
    falling = {name: optax.cosine_decay_schedule(rate, steps, SLOWEST) for name, rate in rates.items()}
    return optax.multi_transform({name: optax.adam(rate, eps=1e-15) for name, rate in falling.items()}, label)
