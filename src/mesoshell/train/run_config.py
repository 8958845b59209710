"""The record of a run in its folder, config.json, and its list of snapshots.

Notation
record      {"method": which of METHODS, "config": the fields of its configuration, "data": of the dataset it was begun with};
            the GAN's has no "method", as older records have none
"""

import json
import math
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

import jax

from mesoshell.errors import InputError
from mesoshell.io.atomic import replace_file
from mesoshell.io.dataset import Dataset
from mesoshell.io.exemplars import Exemplars
from mesoshell.io.query_dataset import Patches
from mesoshell.io.records import read_object, read_rows
from mesoshell.neutex.capture import Capture
from mesoshell.train.fit.patch_rays import FitData
from mesoshell.train.fit.state import FitConfig
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.nerf_tex.network import NerfTexConfig
from mesoshell.train.neutex.step import NeuTexTrainConfig
from mesoshell.train.surface.step import SurfaceTrainConfig
from mesoshell.train.textures.state import TexturesConfig

#: The configuration of a run, by any method.
RunConfig = GanConfig | NerfTexConfig | SurfaceTrainConfig | NeuTexTrainConfig | FitConfig | TexturesConfig
METHODS: dict[str, type[RunConfig]] = {
    "gan": GanConfig,
    "nerf_tex": NerfTexConfig,
    "surface": SurfaceTrainConfig,
    "atlas": NeuTexTrainConfig,
    "fit": FitConfig,
    "textures": TexturesConfig,
}
#: Entries of a dataset's manifest that a record keeps, to tell which data the run was begun with.
KEPT = (
    "recipe",
    "source",
    "digest",
    "background",
    "box",
    "version",
    "size",
    "seed",
    "parameters",
    "depth",
    "curvature",
    "queries",
    "spp",
    "narrowest",
    "widest",
    "finest",
    "patch",
    "views",
    "coverage_range",
    "denoise",
    "samples_per_pixel",
    "fixed_parameters",
    "photographs",
)
#: Entries of KEPT that older records lack.
LATER = ("patch", "views", "coverage_range", "denoise", "samples_per_pixel", "fixed_parameters", "photographs")
#: Fields whose values may change when a run is resumed.
MAY_CHANGE = ("config.kimg", "config.snapshot_kimg", "data.folder")


def keep_record(
    config: RunConfig,
    dataset: Dataset | Patches | Capture | FitData | Exemplars,
    folder: Path,
    transfer: Path | None = None,
) -> None:
    """Write config.json, or compare with it: a run folder belongs to one configuration and one kind of data, except for
    MAY_CHANGE. `transfer` need not be given again. A field that is missing in an old record has its default. Raises InputError
    that names the fields that differ."""
    manifest = dataset.manifest
    folder = folder.resolve()  # else A/../B does not exist before A is made, and afterwards may be another run's
    path = folder / "config.json"
    begun = read_record(folder) if path.exists() else (None, {})
    lent = str(transfer.resolve()) if transfer else begun[1].get("transfer")
    data = {k: manifest[k] for k in KEPT if k in manifest} | {"folder": str(dataset.folder.resolve())}
    record = _record(config, data | ({"transfer": lent} if lent else {}))
    if begun[0] is not None:
        old, new = flat(_record(*begun)), flat(record)
        if old.get("method") != new.get("method"):
            names = [x.get("method", "gan") for x in (old, new)]
            raise InputError(path, f"the run was begun by another method: {names[0]}, asked for {names[1]}")
        unknown = [f"data.{name}" for name in LATER if name not in begun[1]]
        new = {k: x for k, x in new.items() if not k.startswith(tuple(unknown))}
        differ = [k for k in sorted(old.keys() | new.keys()) if old.get(k) != new.get(k) and k not in MAY_CHANGE]
        if differ:
            differences = ", ".join(f"{k} is {old.get(k)}, asked for {new.get(k)}" for k in differ)
            raise InputError(path, f"the run was begun with another configuration: {differences}")
    if jax.process_index() == 0:
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(path, (json.dumps(record, indent=1) + "\n").encode())


def read_record(folder: Path) -> tuple[RunConfig, dict[str, Any]]:
    """Configuration and data of a run. Raises InputError if `folder` holds none."""
    path = folder / "config.json"
    record = read_object(path)
    try:
        return _made(METHODS[record.get("method", "gan")], record["config"]), record["data"]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(path, f"is no record of a training run: {error}") from None


def _record(config: RunConfig, data: dict[str, Any]) -> Any:
    """The record as JSON reads it back."""
    name = next(name for name, kind in METHODS.items() if kind is type(config))
    method = {} if name == "gan" else {"method": name}
    return json.loads(json.dumps(method | {"config": asdict(config), "data": data}))


def _made(kind: Any, entries: dict[str, Any]) -> Any:
    """A configuration from its fields as JSON has them: objects are configurations inside it, lists are tuples."""
    kinds = {f.name: f.type for f in fields(kind)}
    inner = {f.name: f.type for f in fields(kind) if is_dataclass(f.type)}

    def value(name: str, x: Any) -> Any:
        if name in inner:
            return _made(inner[name], x)
        x = tuple(x) if isinstance(x, list) else x
        if not _fits(kinds.get(name), x):
            raise ValueError(f"{name} is {x!r}")
        return x

    return kind(**{name: value(name, x) for name, x in entries.items()})


def _fits(kind: Any, x: Any) -> bool:
    """Whether a value read from JSON fits a field of this type; types without a JSON form are not checked."""
    if isinstance(kind, UnionType) or get_origin(kind) is Union:
        return any(_fits(k, x) for k in get_args(kind))
    if get_origin(kind) is Literal:
        return x in get_args(kind)
    if kind is float:
        return type(x) in (int, float) and math.isfinite(x)
    if kind in (int, bool, str, NoneType):
        return type(x) is kind
    return get_origin(kind) is not tuple or isinstance(x, tuple)


def snapshots(folder: Path) -> list[tuple[int, Path]]:
    """(Images seen, bundle) of each snapshot, oldest first. Raises InputError if there is none yet."""
    files = sorted((int(p.stem), p) for p in (folder / "snapshots").glob("*.npz") if p.stem.isdigit())
    if not files:
        raise InputError(folder, "has no snapshots yet: a run keeps its first after `snapshot_kimg`, or when it stops")
    return files


def forget_after(path: Path, column: str, last: float) -> None:
    """Drop rows whose `column` is beyond `last` from a file of rows: a killed run wrote them after its newest checkpoint, and
    the run that goes on from there writes them again."""
    kept = [row for row in read_rows(path, (column,)) if row[column] <= last]
    if path.exists():
        replace_file(path, "".join(json.dumps(row) + "\n" for row in kept).encode())


def flat(tree: Any, name: str = "") -> dict[str, Any]:
    """Values by their path, as in `config.generator.texels`."""
    if not isinstance(tree, dict):
        return {name: tree}
    return {k: v for key, value in tree.items() for k, v in flat(value, f"{name}.{key}" if name else key).items()}
