"""A fit from its options to its result: a material, or textures of many patches, with scores.

sheet    predicted images side by side, as linear radiance over black
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.errors import Argument, InputError
from mesoshell.io.bundle import Bundle
from mesoshell.io.dataset import Dataset
from mesoshell.io.exemplars import Exemplars
from mesoshell.io.names import distinct_names
from mesoshell.limits import check_memory, check_seed
from mesoshell.train.export import declared_parameters, to_bundle
from mesoshell.train.fit.feed import adapt
from mesoshell.train.fit.holdout import Scores, held_pictures, score
from mesoshell.train.fit.patch_rays import FitData, gather_fit_data
from mesoshell.train.fit.snapshot import exemplars, provenance
from mesoshell.train.fit.state import FitConfig, FitState, material_of, texture_of
from mesoshell.train.parallel import rows_of


class FitResult(NamedTuple):
    """made: a material of one patch or of corner tiles, or textures of many; scores and sheets: by a dataset's folder."""

    made: Bundle | Exemplars
    scores: dict[Path, Scores]
    sheets: dict[Path, Float[np.ndarray, "h w 3"]]


def fit_config(
    steps: int = 4000,
    rays: int = 2048,
    texels: int = 256,
    width: int = 64,
    held: int = 0,
    decoder: str | None = None,
    seed: int = 0,
) -> FitConfig:
    """steps: in all; rays: of a step; texels: along a patch's side, a power of two; width: of the decoder's layers; held:
    images of each patch, the last ones, that are held out; decoder: a material or exemplars whose decoder is kept fixed. Raises
    InputError for a number out of range, or more than memory holds."""
    for name, value in (("steps", steps), ("rays", rays), ("width", width)):
        if value < 1:
            raise InputError(Argument(name), "must be at least 1")
    if held < 0:
        raise InputError(Argument("held"), "must be at least 0")
    if texels < 1 or texels & (texels - 1):
        raise InputError(Argument("texels"), f"{texels} is not a power of two")
    check_seed(seed)
    # values, gradients and two moments, of 32 channels with their coarser levels, and of the decoder's layers
    check_memory(Argument("texels"), f"a texture of {texels} texels a side", 4 * 4 * 43 * texels**2)
    check_memory(Argument("width"), f"layers of {width} numbers", 4 * 4 * 5 * width**2)
    check_memory(Argument("rays"), f"{rays} rays a step", 4 * rays * width)
    rows = rows_of(rays)
    return FitConfig(
        texels=texels,
        batch=rows,
        rays=rays // rows,
        group=max(4, rows // 2),
        steps=steps,
        trunk=(width, width, width),
        head=(width, width),
        given=decoder or "",
        held=held,
        seed=seed,
    )


def fit_data_for(config: FitConfig, datasets: Sequence[Dataset], tests: Sequence[Dataset]) -> FitData:
    """The pictures of datasets, and of test datasets. Raises InputError if they have too few rays for a step, or more patches
    than memory holds."""
    scored = [*(datasets if config.held else ()), *tests]
    for dataset in scored:
        _check_scored(dataset)
    data = gather_fit_data(datasets, config.held, tests)
    for dataset in scored:
        if not held_pictures(data, dataset.folder):
            raise InputError(dataset.folder, "has no held-out picture that shows its patch: nothing to score")
    count, needed = sum(map(len, data.learned)), config.rays * config.batch
    if needed > count:
        raise InputError(Argument("rays"), f"{needed} a step: the datasets have {count} that meet the box")
    # a texture with its coarser levels, gradient and two moments, and its occupancy
    patches = len(data.learned)
    check_memory(Argument("texels"), f"textures of {patches} patches", patches * (16 * 43 * config.texels**2 + 2**19))
    return data


def _rounded(scores: Scores) -> dict[str, float]:
    """Those that there are."""
    return {k: round(v, 3) for k, v in scores._asdict().items() if np.isfinite(v)}


def _check_scored(dataset: Dataset) -> None:
    """Raise InputError if what is held out has a size that `compare` cannot score."""
    for width, height in {sample.size for sample in dataset.samples}:
        if min(width, height) < 12 or width % 4 or height % 4:
            fault = (
                f"has pictures of {width} × {height} pixels; those held out need sides of 12 or more, multiples of 4"
            )
            raise InputError(dataset.folder, fault)


def conclude(
    config: FitConfig, data: FitData, state: FitState, datasets: Sequence[Dataset], tests: Sequence[Dataset]
) -> FitResult:
    """The result of a finished fit, scored on held-out pictures and on tests."""
    config, data = adapt(config, data)
    scores, sheets = {}, {}
    for dataset in [*(datasets if config.held else ()), *tests]:
        scored, pictures = score(
            config, data, lambda k: material_of(state.common, texture_of(config, state, k)), dataset.folder
        )
        scores[dataset.folder], sheets[dataset.folder] = scored, _sheet(pictures)
    names = distinct_names(list(scores))
    tested = {n: _rounded(s) for n, s in zip(names, scores.values(), strict=True)}
    about: dict[str, Any] = provenance(config, data, state) | {"test": tested}
    if config.patches > 1 and not config.tiles:
        return FitResult(exemplars(config, data, state, about), scores, sheets)
    parameters, colours = declared_parameters(data.manifest), data.manifest["tiles"] if config.tiles else None
    return FitResult(to_bundle(config, state.common, state.own.feature[0], parameters, about, colours), scores, sheets)


def _sheet(y: np.ndarray, columns: int = 6, most: int = 96) -> np.ndarray:
    """Predicted images side by side, at most `most`, evenly spaced."""
    y = y[np.unique(np.linspace(0, len(y) - 1, most).astype(int))]
    n, h, w = y.shape[:3]
    rows = -(-n // columns)
    sheet = np.zeros((rows * h, columns * w, 3), np.float32)
    for i in range(n):
        r, c = divmod(i, columns)
        sheet[r * h : (r + 1) * h, c * w : (c + 1) * w] = y[i, ..., :3]
    return sheet
