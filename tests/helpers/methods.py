"""Every method at a size that a test can compile, with data for it, whatever process it is for."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from mesoshell.io.dataset import read_dataset
from mesoshell.io.exemplars import Exemplars, write_exemplars
from mesoshell.io.pack import pack_dataset
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.shell.material.decoder import init_decoder
from mesoshell.surface_material.network import SurfaceConfig
from mesoshell.train.checkpoint import Checkpoints
from mesoshell.train.export import decoder_arrays
from mesoshell.train.fit.state import FitConfig
from mesoshell.train.method import Method, method_of
from mesoshell.train.surface.step import SurfaceTrainConfig
from mesoshell.train.textures.state import TexturesConfig
from tests.helpers import atlas_step, balls, fog, parametric_step, small_step, wearing

STEPS = 6
CONFIGS: dict[str, Any] = {
    "gan": replace(small_step.CONFIG, picture=replace(small_step.CONFIG.picture, size=8), batch=4, near_kimg=0.01),
    "nerf_tex": replace(
        parametric_step.CONFIG,
        picture=replace(small_step.CONFIG.picture, size=8),
        trunk=(4,),
        head=(4,),
        octaves=1,
        batch=4,
        near_kimg=0.01,
        seeded=True,
    ),
    "surface": SurfaceTrainConfig(SurfaceConfig(8, 3, (8,)), batch=256),
    "atlas": replace(atlas_step.CONFIG, side=32),
    "textures": TexturesConfig(
        GeneratorConfig(32, "T", 64, 4, channels=4, layers=4, z=0, w=4, waves=2, height_width=4), batch=4
    ),
    "fit": FitConfig(4, 4, 4, 1, (8,), (8,), batch=8, rays=16, group=4, candidates=8),
}


def write(method: str, folder: Path) -> Path:
    """A folder of data for a method."""
    if method == "surface":
        return wearing.write_patches(folder / "set", [wearing.rows(64, k, _answer) for k in range(6)])
    if method == "atlas":
        return balls.write_capture(folder / "ball", views=16, size=32)
    if method == "textures":
        folder.mkdir()
        write_exemplars(folder / "noise.npz", _noise())
        return folder / "noise.npz"
    if method == "fit":
        fog.write(folder / "many", [(0.6, 0.3, 1.6 + 0.2 * k) for k in range(12)], 8, [k // 3 for k in range(12)])
        return folder / "many"
    fog.write(folder / "fog", [(0.6, 0.3, 1.6 + 0.2 * k) for k in range(16)], size=8)
    pack_dataset(read_dataset(folder / "fog"), folder / "packed")
    return folder / "packed"


def _noise() -> Exemplars:
    """Six patches of noise, and a decoder that has learned nothing."""
    rng = np.random.default_rng(0)
    decoder = decoder_arrays(init_decoder(jax.random.key(0), 4 + 1 + 2, (4,), (4,)))
    features = rng.normal(size=(6, 32, 32, 4)).astype(np.float32)
    about = {"datasets": [{"recipe": "noise"}]}
    return Exemplars(features, rng.normal(size=(8, 4)), np.zeros((6, 0), np.float32), decoder, 1, (), about)


def _answer(q: dict[str, np.ndarray]) -> dict[str, Any]:
    alpha = np.clip(0.5 + q["w"][:, 2] * 0.7, 0, 1)
    return {"alpha": alpha, "cosine": np.clip(0.3 + 0.1 * q["kappa"], 0, 1), "rgb": alpha[:, None] * np.full(3, 0.1)}


def subject(method: str, folder: Path) -> tuple[Any, Any]:
    """A run of STEPS steps, and what it learns from."""
    config = CONFIGS[method]
    fit = isinstance(config, FitConfig)
    length = {"steps": STEPS, "kept": 10**9} if fit else {"kimg": STEPS * config.batch / 1000, "snapshot_kimg": 1e9}
    config = replace(config, **length)
    return config, method_of(config).read(config, {"folder": folder})


def light(method: Method) -> Method:
    """The same in float64, so that another order of sums changes little, with files that need nothing compiled."""

    def exact(tree: Any) -> Any:
        return jax.tree.map(lambda x: np.asarray(x, np.float64) if np.asarray(x).dtype.kind == "f" else x, tree)

    def fed(*arguments: Any) -> Any:
        at = method.feed(*arguments)
        return lambda i: exact(at(i))

    return method._replace(
        feed=fed,
        start=lambda *given: jax.tree.map(jax.numpy.asarray, exact(method.start(*given))),
        save=lambda path, config, data, state: path.write_bytes(b""),
        sheet=lambda config, data, state: np.zeros((2, 2, 3), np.float32),
    )


def keep(state: Any, path: Path) -> None:
    np.savez(path, *(np.asarray(x) for x in jax.tree.leaves(state)))


def kept(path: Path) -> list[np.ndarray]:
    with np.load(path) as file:
        return [file[name] for name in file.files]


def counted(state: list[np.ndarray]) -> int:
    """Steps, which every method's state holds last but one."""
    return int(state[-2])


@cache
def plain_save() -> Any:
    return Checkpoints.save
