"""Which code of this package wrote a file: for the provenance of bundles."""

import os
import subprocess
from functools import lru_cache
from pathlib import Path

from mesoshell import __version__

_PACKAGE = Path(__file__).resolve().parents[1]


@lru_cache
def commit(package: Path = _PACKAGE) -> str:
    """The commit of the checkout that holds the package's sources, whatever the working directory; of an installed package,
    "mesoshell" and its version."""
    if _git(package, "ls-files", "--error-unmatch", "__init__.py") is not None:
        found = _git(package, "rev-parse", "HEAD")
        if found:
            return found
    return f"mesoshell {__version__}"


def _git(folder: Path, *words: str) -> str | None:
    """What git says of a folder; None if it refuses, or is not installed. A repository named in the environment is another."""
    plain = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
    try:
        done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, env=plain)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None
