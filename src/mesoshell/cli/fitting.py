"""The work of `mesoshell fit`. Imports JAX, so it is loaded only when it runs."""

import numpy as np
from rich.console import Console

from mesoshell.cli.fit import Options, rows_of
from mesoshell.cli.training import learn
from mesoshell.errors import InputError
from mesoshell.io.bundle import write_bundle
from mesoshell.io.dataset import read_dataset
from mesoshell.io.exemplars import write_exemplars
from mesoshell.io.image import write_png
from mesoshell.io.names import distinct_names
from mesoshell.io.whole import probe_outputs
from mesoshell.limits import check_memory, check_seed
from mesoshell.train.export import declared, to_bundle
from mesoshell.train.fit import FitConfig, fitted, material_of
from mesoshell.train.fit_snapshot import exemplars, provenance
from mesoshell.train.holdout import Scores, score
from mesoshell.train.shots import shots_of


def fit_to_file(options: Options) -> None:
    """All of `mesoshell fit`."""
    console = Console(stderr=True)
    config = _config(options)
    probe_outputs((options.out,))
    datasets, tests = ([read_dataset(d) for d in folders] for folders in (options.datasets, options.test))
    if not datasets:
        raise InputError("fit", "no dataset given")
    with console.status("reading images"):
        shots = shots_of(datasets, options.held, tests)
    count = sum(map(len, shots.learned))
    console.print(f"{count:,} rays of {len(shots.learned)} patches in {len(shots.samples):,} images", highlight=False)
    if options.rays > count:
        raise InputError("--rays", f"{options.rays} a step: the datasets have {count} that meet the box")
    # a texture with its coarser levels, gradient and two moments, and what is kept of emptiness
    check_memory(
        "--texels",
        f"textures of {len(shots.learned)} patches",
        len(shots.learned) * (16 * 43 * options.texels**2 + 2**19),
    )
    state = learn(config, shots, options.run)
    config, shots = fitted(config, shots)
    about = provenance(config, shots, state) | {"test": {}}
    judged = [*(datasets if options.held else ()), *tests]
    for dataset, name in zip(judged, distinct_names([d.folder for d in judged]), strict=True):
        scores, pictures = score(
            config, shots, lambda k: material_of(state.common, state.own.feature[k]), dataset.folder
        )
        about["test"][name] = {k: round(v, 3) for k, v in scores._asdict().items()}
        console.print(f"{dataset.folder}: {_said(scores)}", highlight=False)
        write_png(options.run / f"{name}.png", _sheet(pictures))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    if config.patches > 1:
        write_exemplars(options.out, exemplars(config, shots, state, about))
    else:
        said = declared(shots.manifest)
        write_bundle(options.out, to_bundle(config, state.common, state.own.feature[0], said, about))
    print(options.out)


def _config(options: Options) -> FitConfig:
    for name in ("steps", "rays", "width"):
        if getattr(options, name) < 1:
            raise InputError(f"--{name}", "must be at least 1")
    if options.held < 0:
        raise InputError("--held", "must be at least 0")
    if options.texels < 1 or options.texels & (options.texels - 1):
        raise InputError("--texels", f"{options.texels} is not a power of two")
    check_seed(options.seed)
    w = options.width
    # with gradients and two moments: 32 channels with their coarser levels, and the decoder's layers
    check_memory("--texels", f"a texture of {options.texels} texels a side", 4 * 4 * 43 * options.texels**2)
    check_memory("--width", f"layers of {w} numbers", 4 * 4 * 5 * w**2)
    check_memory("--rays", f"{options.rays} rays a step", 4 * options.rays * w)
    rows = rows_of(options)
    return FitConfig(
        texels=options.texels,
        batch=rows,
        rays=options.rays // rows,
        steps=options.steps,
        trunk=(w, w, w),
        head=(w, w),
        given=options.decoder or "",
        held=options.held,
        seed=options.seed,
    )


def _said(scores: Scores) -> str:
    return ", ".join(
        f"{k} {v:+.1%}" if k == "mean" else f"{k} {v:.2f}{'' if k == 'ssim' else ' dB'}"
        for k, v in scores._asdict().items()
    )


def _sheet(y: np.ndarray, columns: int = 6, most: int = 96) -> np.ndarray:
    """Predicted images side by side, as linear radiance over black, evenly chosen of many."""
    y = y[np.unique(np.linspace(0, len(y) - 1, most).astype(int))]
    n, h, w = y.shape[:3]
    rows = -(-n // columns)
    sheet = np.zeros((rows * h, columns * w, 3), np.float32)
    for i in range(n):
        r, c = divmod(i, columns)
        sheet[r * h : (r + 1) * h, c * w : (c + 1) * w] = y[i, ..., :3]
    return sheet
