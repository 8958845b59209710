"""Fit and train materials. Imports JAX, so it is loaded when one of its names is first used."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Literal

from mesoshell.errors import Argument, InputError
from mesoshell.io.atomic import probe_folder
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.dataset import read_dataset
from mesoshell.io.exemplars import Exemplars, write_exemplars
from mesoshell.scene.materials import Material, load_material
from mesoshell.train import run as runs
from mesoshell.train.experiment import check_recipe, experiment_of, read_data, with_kimg
from mesoshell.train.export import patch_bundle
from mesoshell.train.fit.holdout import Scores
from mesoshell.train.fit.result import conclude, fit_config, fit_data_for
from mesoshell.train.gan.presets import PRESETS
from mesoshell.train.method import Data
from mesoshell.train.prefilter import Gap, fit_correction
from mesoshell.train.run_config import RunConfig, snapshots

#: Called with each row of the log: kimg, images_per_s and losses.
ShowRow = Callable[[dict[str, float]], None]


@dataclass(frozen=True, eq=False)
class Fit:
    """A finished fit. made: a material of one patch, or textures of many patches with one decoder; scores: of held-out
    pictures, by their dataset's folder; folder: of checkpoints and log."""

    made: Bundle | Exemplars = field(repr=False)
    scores: dict[Path, Scores]
    folder: Path

    def material(self, patch: int = 0) -> Material:
        """A patch as a material that repeats. Raises InputError if there is no patch of this number."""
        count = 1 if isinstance(self.made, Bundle) else len(self.made.features)
        if not 0 <= patch < count:
            raise InputError(Argument("patch"), f"there are {count} patches: 0 to {count - 1}, not {patch}")
        return Material(
            str(self.folder), self.made if isinstance(self.made, Bundle) else patch_bundle(self.made, patch)
        )

    def save(self, path: str | PathLike[str]) -> None:
        """Write a material, or, for many patches, the exemplars that `train` learns from. Raises InputError if it cannot be
        written."""
        if isinstance(self.made, Bundle):
            write_bundle(path, self.made)
        else:
            write_exemplars(path, self.made)


def fit(
    datasets: Sequence[str | PathLike[str]],
    folder: str | PathLike[str] = "runs/fit",
    *,
    test: Sequence[str | PathLike[str]] = (),
    held: int = 0,
    decoder: str | PathLike[str] | None = None,
    steps: int = 4000,
    rays: int = 2048,
    texels: int = 256,
    width: int = 64,
    seed: int = 0,
    show: ShowRow = lambda row: None,
) -> Fit:
    """Fit patches to the datasets that show them, as `mesoshell fit` does; a repeated call goes on from the folder.

    test: datasets that only score the result. held: images of each patch that are held out. decoder: a material or exemplars
    whose decoder is kept fixed. steps: in all. rays: of a step. texels: along a patch's side, a power of two. width: of the
    decoder's layers. Raises InputError, which names the argument or the file at fault; train.run.Diverged if
    something is not finite.
    """
    if isinstance(datasets, str | PathLike) or not datasets:
        raise InputError(Argument("datasets"), f"must be a list of one dataset's folder or more, not {datasets!r}")
    if isinstance(test, str | PathLike):
        raise InputError(Argument("test"), f"must be a list of datasets' folders, not {test!r}")
    given = None if decoder is None else fspath(decoder)
    config, at = fit_config(steps, rays, texels, width, held, given, seed), Path(folder)
    learned, tests = ([read_dataset(path) for path in paths] for paths in (datasets, test))
    data = fit_data_for(config, learned, tests)
    probe_folder(at, Argument("folder"))
    state = runs.train(config, data, at, "jit", show, again=True)
    made, scores, _ = conclude(config, data, state, learned, tests)
    return Fit(made, scores, at)


def prefilter(
    material: Material, *, steps: int = 300, seed: int = 0, show: Callable[[Gap], None] = lambda gap: None
) -> Material:
    """The material, corrected for views from afar as by `mesoshell prefilter`: it learns from its own unfiltered rays. It is in
    no file until it is saved, and has no twin.

    steps: of each level of the texture. seed: of views and rays. show: called with each level's `Gap`. Raises InputError for a
    surface material, for one texture with edges, and for more textures than memory holds, about the material; about `steps` and
    `seed`.
    """
    return Material(f"{material.name}, corrected", fit_correction(material.shell, material.name, steps, seed, show))


@dataclass(frozen=True, eq=False)
class Run:
    """A training run at its end. config: what it was begun with; state: of its method (`train.method`), a pytree of arrays."""

    folder: Path
    config: RunConfig
    state: Any = field(repr=False)

    @property
    def snapshots(self) -> dict[int, Path]:
        """Files of the materials or networks that the run kept, by the number of images seen."""
        return dict(snapshots(self.folder))

    def material(self) -> Material:
        """The newest snapshot. Raises InputError if the method makes no materials."""
        return load_material(snapshots(self.folder)[-1][1])


def train(
    config: RunConfig | str | PathLike[str],
    data: Data | str | PathLike[str],
    folder: str | PathLike[str],
    *,
    preset: str | None = None,
    kimg: float | None = None,
    transfer: str | PathLike[str] | None = None,
    parallel: Literal["jit", "pmap"] = "jit",
    show: ShowRow = lambda row: None,
) -> Run:
    """Train as `mesoshell train` does; a run that was stopped goes on from its folder.

    config: an experiment's file, or its `config`; data: a dataset's folder, a file of exemplars, or either as it was read.
    preset: the file's experiment at another size; kimg: another length, thousands of images; transfer: a run, or a snapshot,
    whose weights this one begins with; parallel: how a step is spread over devices. Raises InputError, which names the argument
    or the file at fault; train.run.Diverged if something is not finite.
    """
    if preset not in (None, *PRESETS):
        raise InputError(Argument("preset"), f"must be one of {', '.join(PRESETS)}, not {preset}")
    if parallel not in ("jit", "pmap"):
        raise InputError(Argument("parallel"), f"must be jit or pmap, not {parallel}")
    at, file, recipe = Path(folder), None, None
    if isinstance(config, str | PathLike):
        file = Path(config)
        begun, recipe = experiment_of(file, preset)
    elif preset is not None:
        raise InputError(Argument("preset"), "requires an experiment's file")
    elif isinstance(config, RunConfig):
        begun = config
    else:
        raise InputError(Argument("config"), f"{config!r} is neither an experiment's file nor its `config`")
    begun = with_kimg(begun, kimg)
    dataset = read_data(begun, data, at) if isinstance(data, str | PathLike) else data
    if file is not None:
        check_recipe(file, recipe, dataset)
    probe_folder(at, Argument("folder"))
    lent = Path(transfer) if transfer else None
    return Run(at, begun, runs.train(begun, dataset, at, parallel, show, lent, again=True))
