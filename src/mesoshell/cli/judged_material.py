"""What `mesoshell judge` compares: a material by name or file, or the newest snapshot of a run. Imports JAX."""

from pathlib import Path

from mesoshell.io.bundle import Bundle, read_bundle
from mesoshell.io.dataset import Dataset
from mesoshell.io.material import find
from mesoshell.measure.posed import Posed, pose_material
from mesoshell.train.patch_renderer import PictureConfig
from mesoshell.train.run_config import read_record, snapshots


def pose_named(name: str, dataset: Dataset) -> Posed:
    """A material that makes pictures from the dataset's cameras. Raises InputError."""
    return pose_material(bundle_of(name), name, dataset, _taken(name))


def bundle_of(name: str) -> Bundle:
    """A material's bundle, or that of a run's newest snapshot."""
    return read_bundle(snapshots(Path(name))[-1][1] if _is_run(name) else find(name))


def _taken(name: str) -> PictureConfig | None:
    """How a run renders its pictures; None for a material."""
    picture = getattr(read_record(Path(name))[0], "picture", None) if _is_run(name) else None
    return picture if isinstance(picture, PictureConfig) else None


def _is_run(name: str) -> bool:
    return (Path(name) / "config.json").is_file()
