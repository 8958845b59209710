"""Compile what a picture needs side by side, before its tiles ask for it one after the other, each of them on every thread.

Each program is called with rows of zeros and a count of 0: what is compiled is what tiles will call.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.nets.batches import CAPACITY
from mesoshell.render.quality import Quality
from mesoshell.shell.geometry.batched_walk import compile_walk
from mesoshell.shell.geometry.march import Prisms
from mesoshell.shell.geometry.sampling import Frame, Piece
from mesoshell.shell.render import kernels, spacing
from mesoshell.shell.render.kernels import DeviceTables, Samples, StaticConfig
from mesoshell.shell.render.lighting import jacobians
from mesoshell.shell.render.media import Decoding

NONE, I = np.int32(0), np.zeros(CAPACITY, np.int32)


def compile_ahead(media: Sequence[Decoding], prisms: Prisms, quality: Quality, lights: int, rows: int) -> None:
    """Compile the programs of a tile, those that take longest first. lights: toward which a ray is lit; rows: of its padded
    intervals."""
    # of several that compile alike, one
    tables = {(d.program, jax.tree.structure(d.table)): d.table for d in media}
    chart = media[0].table.chart
    wide = ((), (2,), (2, 2), (2,), (3,), (3,))
    pieces = Piece(*(jnp.zeros((rows, *shape), jnp.float32 if shape else jnp.int32) for shape in wide))
    at = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(kernels.frames, chart, pieces, NONE))
    calls: list[Callable[[], object]] = [lambda: compile_walk(prisms, exact=True)]
    for (program, _), table in tables.items():
        calls += _calls(program, table, pieces, at, quality, lights)
    calls.insert(2, lambda: compile_walk(prisms, exact=False))
    if lights:
        calls.append(lambda: jacobians(chart, I[:1], _rows(2)[:1]))
    if quality.spacing == "density":
        calls.append(lambda: spacing.places(quality.samples, _rows(spacing.BINS), np.float32(0), NONE))
    calls.append(lambda: kernels.frames(chart, pieces, NONE))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for _ in pool.map(lambda call: call(), calls):
            pass


def _rows(*shape: int) -> np.ndarray:
    return np.zeros((CAPACITY, *shape), np.float32)


def _calls(
    program: StaticConfig, table: DeviceTables, pieces: Piece, at: Frame, quality: Quality, lights: int
) -> list[Callable[[], object]]:
    """A call of each program of a material."""
    samples = Samples(I, _rows(), _rows(), _rows())
    features = jnp.asarray(_rows(table.material.decoder.trunk[-1].bias.shape[0]))
    calls: list[Callable[[], object]] = [lambda: kernels.density(program, table, pieces, at, samples, NONE)]
    if lights:
        calls.append(lambda: kernels.transport(table, at, pieces, features, I, I, _rows(lights, 3), NONE))
        calls.append(lambda: kernels.density_at(program, table, _rows(3), _rows(), NONE))
    if program.baked is not None:
        calls.append(lambda: kernels.baked_depths(program, table, pieces, at, samples, NONE))
    if quality.spacing == "density":
        segments = jnp.zeros((len(pieces.prism), 7), jnp.float32)
        calls.append(lambda: spacing.interval_segments(program, table, pieces, at, NONE))
        calls.append(lambda: spacing.depth_profile(program, table.grid, segments, I, _rows(), _rows(), NONE))
    elif quality.skip > 0:
        calls.append(lambda: kernels.depth_bounds(program, table, pieces, at, samples, NONE))
    return calls
