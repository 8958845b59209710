"""Snapshots of a run of the NeRF-Tex network: its weights, and a sheet of pictures.

Notation
snapshot    an archive of arrays (io/archive), PART/LAYER/kernel and bias; the kind in its manifest.json is not a
            bundle's, so readers of materials refuse it
sheet       rows of six: near renders and pictures of the same, far renders and pictures of the same
"""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.archive import MANIFEST, read_arrays, read_heads, write_arrays
from mesoshell.io.bundle import SCHEMA
from mesoshell.io.dataset import Dataset
from mesoshell.shell.material.decoder import Decoder
from mesoshell.train.gan.generate import ImageBatch
from mesoshell.train.gan.snapshot import ends, in_rows, provenance
from mesoshell.train.nerf_tex.network import NerfTexConfig, NerfTexState, paint, redrawn, start
from mesoshell.train.parallel import in_turn
from mesoshell.typing import Array


def save(path: Path, config: NerfTexConfig, dataset: Dataset, state: NerfTexState) -> None:
    """The network's weights."""
    about = {"schema": SCHEMA, "kind": "nerf_tex", "provenance": provenance(config, dataset, int(state.images))}
    text = np.frombuffer(json.dumps(about, indent=1, sort_keys=True).encode(), np.uint8)
    write_arrays(path, {MANIFEST: text} | {name: np.asarray(leaf) for name, leaf in _named(state.decoder).items()})


def load_predictor(config: NerfTexConfig, path: Path) -> Callable[[ImageBatch], Float[np.ndarray, "B S S 4"]]:
    """A function that makes pictures of a snapshot with the labels of a batch, and with seeds drawn by its keys. Raises
    InputError if the file does not hold this configuration's network."""
    like = jax.eval_shape(lambda: start(config, jax.random.key(0))).decoder
    named, heads = _named(like), read_heads(path)
    for name, leaf in named.items():
        if name not in heads or heads[name] != (leaf.shape, leaf.dtype):
            raise InputError(path, f"array {name} is not of shape {leaf.shape} and {leaf.dtype}, as config.json has it")
    arrays = read_arrays(path, named)
    decoder = jax.tree.unflatten(jax.tree.structure(like), [jnp.asarray(arrays[name]) for name in named])
    return lambda batch: pictures(config, decoder, redrawn(config, batch))


def sheet(config: NerfTexConfig, dataset: Dataset, state: NerfTexState) -> Float[np.ndarray, "h w 3"]:
    """Renders beside what the network makes of them, as linear values to be shown."""
    far, near = ends(config, dataset)
    return in_rows([rows for batch in (near, far) for rows in (batch.image, pictures(config, state.decoder, batch))])


def pictures(config: NerfTexConfig, decoder: Decoder, batch: ImageBatch) -> Float[np.ndarray, "B S S 4"]:
    """Pictures with the labels of a batch."""
    return np.asarray(_pictures(config, decoder, jax.tree.map(jnp.asarray, batch)))


@partial(jax.jit, static_argnums=0)
def _pictures(config: NerfTexConfig, decoder: Decoder, batch: ImageBatch) -> Array:
    return paint(config, decoder, batch, in_turn)


def _named(decoder: Decoder) -> dict[str, Any]:
    """Leaves by their names in a file, in the tree's order."""
    leaves = jax.tree_util.tree_leaves_with_path(decoder)
    return {jax.tree_util.keystr(path, simple=True, separator="/"): leaf for path, leaf in leaves}
