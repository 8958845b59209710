"""Which code of this package wrote a file: for the provenance of bundles."""

import os
import subprocess
from functools import lru_cache
from pathlib import Path

from mesoshell import __version__

_PACKAGE = Path(__file__).resolve().parents[1]


@lru_cache
def commit(package: Path = _PACKAGE) -> str:
    """The commit of the package's checkout, whatever the working directory; "mesoshell" and its version if there is none."""
    if _git(package, "ls-files", "--error-unmatch", "__init__.py") is not None:
        head = _git(package, "rev-parse", "HEAD")
        if head:
            return head
    return f"mesoshell {__version__}"


def _git(folder: Path, *words: str) -> str | None:
    """Output of git in a folder; None if git fails or is not installed. Ignores a repository named in the environment."""
    plain = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
    try:
        done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, env=plain)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None
