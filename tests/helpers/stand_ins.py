"""What the tests of the farm share: settings for the stand-in, and what a folder holds."""

import sys
from pathlib import Path

from mesoshell.datasets.blender.shard import Fault

STAND_IN = (sys.executable, str(Path(__file__).parent / "stand_in.py"))


def settings(recipe: str = "grass", seed: int = 0) -> dict:
    return {"recipe": recipe, "seed": seed, "size": 4}


def ignore(finished: int, missing: int, fault: Fault | None) -> None:
    pass


def contents(folder: Path) -> dict[str, bytes]:
    """Everything in a dataset folder but its log."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != "log.jsonl")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}
