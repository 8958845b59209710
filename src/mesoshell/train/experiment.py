"""Experiment files: Python code that defines the configuration of a run."""

import runpy
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from mesoshell.errors import Argument, InputError
from mesoshell.train.fit.state import FitConfig
from mesoshell.train.gan.presets import PRESETS
from mesoshell.train.method import Data, method_of
from mesoshell.train.run_config import RunConfig, read_record


def read_experiment(path: Path, preset: str | None = None) -> Any:
    """The `config` of an experiment file, or its `variant` of a preset: a RunConfig. Raises InputError if the file fails or
    does not define it."""
    return experiment_of(path, preset)[0]


def experiment_of(path: Path, preset: str | None = None) -> tuple[Any, str | None]:
    """The configuration as `read_experiment` gives it, and the file's `recipe`, if it names one. Runs the file once."""
    wanted = "config" if preset is None else "variant"
    defined = _defined(path)
    value = defined.get(wanted)
    try:
        config = value(PRESETS[preset]) if preset is not None and callable(value) else value
    except SystemExit as end:
        raise InputError(path, f"`variant` ends the program (sys.exit: {end.code!r})") from None
    except Exception as error:
        raise InputError(path, f"{type(error).__name__}: {error}") from error
    if not isinstance(config, RunConfig) or isinstance(config, FitConfig):
        of = {"config": "that is", "variant": "that makes of a GanConfig"}[wanted]
        raise InputError(
            path,
            f"defines no `{wanted}` {of} a GanConfig, a TexturesConfig, a NerfTexConfig, a SurfaceTrainConfig or a "
            "NeuTexTrainConfig (mesoshell.train: gan.state, textures.state, nerf_tex.network, surface.step, neutex.step)",
        )
    return config, defined.get("recipe")


def read_data(config: RunConfig, data: str | PathLike[str], run: Path) -> Data:
    """The data at this path, read with the options that the run was begun with, if it has been. Raises InputError."""
    begun = read_record(run)[1] if (run / "config.json").exists() else {}
    return method_of(config).read(config, {**begun, "folder": data})


def check_recipe(path: Path, recipe: str | None, dataset: Data) -> None:
    """Raises InputError if the experiment is about one `recipe` and the dataset is of another."""
    if recipe not in (None, dataset.recipe):
        raise InputError(dataset.folder, f"its recipe is {dataset.recipe}; {path.name} is about {recipe}")


def with_kimg(config: Any, kimg: float | None) -> Any:
    """The configuration with another `kimg`, if one is given. Raises InputError."""
    if kimg is None:
        return config
    if not (np.isfinite(kimg) and kimg > 0):
        raise InputError(Argument("kimg"), f"must be above 0 and finite, not {kimg}")
    return replace(config, kimg=kimg)


def _defined(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(path, "no such file")
    try:
        return runpy.run_path(str(path))
    except SystemExit as end:
        raise InputError(path, f"ends the program (sys.exit: {end.code!r}) instead of defining an experiment") from None
    except Exception as error:
        raise InputError(path, f"{type(error).__name__}: {error}") from error
