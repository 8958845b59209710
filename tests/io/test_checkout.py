"""Which code wrote a file. Oracle: repositories made here."""

import os
import subprocess
from pathlib import Path

import pytest

from mesoshell import __version__
from mesoshell.io.checkout import commit

VERSION = f"mesoshell {__version__}"


def git(folder: Path, *words: str) -> str:
    who = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    plain = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
    done = subprocess.run(["git", "-C", folder, *who, *words], check=True, capture_output=True, text=True, env=plain)
    return done.stdout.strip()


def repository(folder: Path, *tracked: str) -> str:
    """A repository that holds some files; its commit."""
    folder.mkdir(parents=True, exist_ok=True)
    git(folder, "init", "-q")
    for name in tracked:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
        git(folder, "add", name)
    git(folder, "commit", "-q", "--allow-empty", "-m", str(folder))
    return git(folder, "rev-parse", "HEAD")


def installed(folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "__init__.py").touch()
    return folder


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch) -> None:
    """The user works in a repository of their own, which the environment names as well."""
    repository(tmp_path / "work")
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv("GIT_DIR", str(tmp_path / "work/.git"))


def test_sources_in_a_checkout(tmp_path) -> None:
    made = repository(tmp_path / "code", "src/mesoshell/__init__.py")
    assert commit(tmp_path / "code/src/mesoshell") == made


def test_a_package_in_a_repository_that_does_not_hold_it(tmp_path) -> None:
    """An environment in the user's own folder."""
    assert commit(installed(tmp_path / "work/.venv/lib/mesoshell")) == VERSION


def test_a_package_in_no_repository(tmp_path) -> None:
    assert commit(installed(tmp_path / "site-packages/mesoshell")) == VERSION


def test_without_git(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PATH", os.devnull)
    assert commit(installed(tmp_path / "no git/mesoshell")) == VERSION
