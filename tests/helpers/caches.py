"""A user's cache of a test's own, but for the compiled programs, which all tests share: the processes that a test starts find
there what others compiled."""

from pathlib import Path

import pytest


def own(folder: Path, factory: pytest.TempPathFactory) -> str:
    """What $XDG_CACHE_HOME is to be: a new folder within this one."""
    base = factory.getbasetemp()
    programs = (base.parent if base.name.startswith("popen-") else base) / "xla"
    programs.mkdir(exist_ok=True)
    (folder / "mesoshell").mkdir(parents=True)
    (folder / "mesoshell" / "xla").symlink_to(programs, target_is_directory=True)
    return str(folder)
