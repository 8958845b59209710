"""Snapshots of a run of a surface material: the material as a bundle, and a sheet of pictures.

Notation
snapshot     a bundle that `mesoshell render` takes (io/surface); its textures are blurred as they are at that time
sheet        rows: flat, and at the greatest trained curvature; columns: from above, then at ever flatter angles; lit from the
             upper left, over a blue background
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

from mesoshell.io.checkout import commit
from mesoshell.io.image import tonemap
from mesoshell.io.query_dataset import Patches
from mesoshell.io.surface import SurfaceBundle, read_surface, write_surface
from mesoshell.surface_material.loader import surface_of
from mesoshell.surface_material.network import Surface, blur_texture
from mesoshell.train.surface.step import QueryBatch, SurfaceState, SurfaceTrainConfig, ask, blur_at, query_batch
from mesoshell.typing import Array

#: Of the sheet: pixels of a picture, periods that it shows, cosines toward the viewer.
SIDE, PERIODS, COSINES = 96, 1.5, (1.0, 0.6, 0.35, 0.2)
BEHIND = np.array([0.05, 0.1, 0.4])


def save(path: Path, config: SurfaceTrainConfig, data: Patches, state: SurfaceState) -> None:
    """The material as it is now."""
    write_surface(path, bundle(config, data, state))


def bundle(config: SurfaceTrainConfig, data: Patches, state: SurfaceState) -> SurfaceBundle:
    """The material as a bundle: half-precision textures, blurred."""
    blur = jnp.maximum(blur_at(config, state.images.astype(jnp.float32) / (config.kimg * 1000)), 1e-3)
    arrays: dict[str, np.ndarray] = {}
    for name, module in state.surface._asdict().items():
        for i, level in enumerate(module.texture):
            arrays[f"{name}/texture/{i}"] = np.asarray(blur_texture(level, blur)).astype(np.float16)
        layers = {f"hidden/{i}": layer for i, layer in enumerate(module.hidden)} | {"last": module.last}
        for key, layer in layers.items():
            arrays |= {f"{name}/{key}/{k}": np.asarray(v, np.float32) for k, v in layer._asdict().items()}
    about = {"config": asdict(config), "dataset": data.manifest, "commit": commit(), "queries": int(state.images)}
    s = config.surface
    return SurfaceBundle(
        texels=s.texels,
        channels=s.channels,
        opacity=s.opacity,
        step=s.step,
        offset=s.offset,
        sees_curvature=s.curvature,
        curvature=config.curvature,
        depth=float(data.manifest["depth"]),
        provenance=about,
        arrays=arrays,
    )


def load_predictor(
    config: SurfaceTrainConfig, path: Path
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """A function from rows of patches to a snapshot's answers: α, the silhouette cosine and ρ."""
    bundle = read_surface(path)
    surface, config = surface_of(bundle), replace(config, curvature=bundle.curvature)

    def answers(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        opacity, rho = _answers(config, surface, jax.tree.map(jnp.asarray, query_batch(rows)))
        return np.asarray(opacity.alpha), np.asarray(opacity.cosine), np.asarray(rho)

    return answers


def sheet(config: SurfaceTrainConfig, data: Patches, state: SurfaceState) -> Float[np.ndarray, "h w 3"]:
    """Pictures of the material alone, as linear values to be shown."""
    grid = (np.arange(SIDE) + 0.5) / SIDE * PERIODS
    v, u = np.meshgrid(grid[::-1], grid, indexing="ij")
    n, rows = u.size, []
    for kappa in (0.0, config.curvature[1]):
        row = []
        for cosine in COSINES:
            w = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
            light = np.array([-0.5, 0.4, 0.768])
            columns = {
                "u": np.stack([u, v], axis=-1).reshape(-1, 2) % 1.0,
                "radius": np.full(n, PERIODS / SIDE / 4),
                "w": np.tile(w, (n, 1)),
                "kappa": np.full(n, kappa),
                "light": np.tile(light, (n, 1)),
                "alpha": np.ones(n),
                "cosine": np.ones(n),
                "rgb": np.ones((n, 3)),
            }
            batch = QueryBatch(**{name: jnp.asarray(x, jnp.float32) for name, x in columns.items()})
            opacity, rho = _current(config, state, batch)
            alpha = np.asarray(opacity.alpha)[:, None]
            row.append((alpha * np.asarray(rho) * 12 + (1 - alpha) * BEHIND).reshape(SIDE, SIDE, 3))
        rows.append(np.concatenate(row, axis=1))
    return np.asarray(tonemap(np.concatenate(rows)), np.float32)


@partial(jax.jit, static_argnums=0)
def _current(config: SurfaceTrainConfig, state: SurfaceState, batch: QueryBatch) -> Any:
    return ask(config, state.surface, batch, blur_at(config, state.images.astype(jnp.float32) / (config.kimg * 1000)))


@partial(jax.jit, static_argnums=0)
def _answers(config: SurfaceTrainConfig, surface: Surface, batch: QueryBatch) -> tuple[Any, Array]:
    return ask(config, surface, batch, jnp.asarray(1e-3, jnp.float32))
