"""What a run's folder says of it: config.json, and the snapshots that there are.

Alphabet
record      {"config": a TrainConfig's fields, "data": of the dataset it was begun with}
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset
from mesoshell.io.whole import read_file, replace_file
from mesoshell.shell.discriminator import DiscriminatorConfig
from mesoshell.shell.generator import GeneratorConfig
from mesoshell.train.picture import PictureConfig
from mesoshell.train.state import TrainConfig

#: What a run may be resumed with another value of.
MAY_CHANGE = ("config.kimg", "config.snapshot_kimg", "data.folder")


def keep_record(config: TrainConfig, dataset: Dataset, folder: Path) -> None:
    """Write config.json, or compare with it: a run folder belongs to one configuration and one kind of data, but for
    MAY_CHANGE. Raises InputError that names the fields that differ."""
    kept = ("recipe", "version", "size", "seed", "parameters")
    data = {k: dataset.manifest[k] for k in kept} | {"folder": str(dataset.folder.resolve())}
    record = json.loads(json.dumps({"config": asdict(config), "data": data}))
    path = folder / "config.json"
    if path.exists():
        old, new = _flat(_parsed(path)), _flat(record)
        differ = [k for k in sorted(old.keys() | new.keys()) if old.get(k) != new.get(k) and k not in MAY_CHANGE]
        if differ:
            said = ", ".join(f"{k} is {old.get(k)}, asked for {new.get(k)}" for k in differ)
            raise InputError(path, f"the run was begun with another configuration: {said}")
    if jax.process_index() == 0:
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(path, (json.dumps(record, indent=1) + "\n").encode())


def read_record(folder: Path) -> tuple[TrainConfig, dict[str, Any]]:
    """Configuration and data of a run. Raises InputError if `folder` is none."""
    path = folder / "config.json"
    record = _parsed(path)
    try:
        fields = dict(record["config"])
        parts = {
            "generator": GeneratorConfig(**fields.pop("generator")),
            "discriminator": DiscriminatorConfig(**fields.pop("discriminator")),
            "picture": PictureConfig(**fields.pop("picture")),
            "trunk": tuple(fields.pop("trunk")),
            "head": tuple(fields.pop("head")),
        }
        return TrainConfig(**parts, **fields), record["data"]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(path, f"is no record of a training run: {error}") from None


def snapshots(folder: Path) -> list[tuple[int, Path]]:
    """(Images seen, bundle) of each snapshot, oldest first. Raises InputError if there is none yet."""
    found = sorted((int(p.stem), p) for p in (folder / "snapshots").glob("*.npz") if p.stem.isdigit())
    if not found:
        raise InputError(folder, "has no snapshots yet: a run keeps its first after `snapshot_kimg`, or when it stops")
    return found


def _parsed(path: Path) -> Any:
    text = read_file(path)
    try:
        return json.loads(text)
    except ValueError:
        raise InputError(path, "not JSON") from None


def _flat(tree: Any, name: str = "") -> dict[str, Any]:
    if not isinstance(tree, dict):
        return {name: tree}
    return {k: v for key, value in tree.items() for k, v in _flat(value, f"{name}.{key}" if name else key).items()}
