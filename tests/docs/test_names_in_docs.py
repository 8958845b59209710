"""What the pages of docs/ name in code is there: files, folders, and functions of the package. Nothing is imported."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
#: The page of the house has short names of its own.
PAGES = sorted(p for p in (ROOT / "docs").rglob("*.md") if p.name != "architecture.md")
FILE = re.compile(r"`((?:src|tests|data_gen|experiments|benchmarks|notebooks|materials|packages|docs)/[\w./]*)`")
NAME = re.compile(r"`(mesoshell(?:\.\w+)+)`")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_files_and_names_are_there(page: Path) -> None:
    text = page.read_text()
    missing = [path for path in FILE.findall(text) if not (ROOT / path).exists()]
    missing += [name for name in NAME.findall(text) if not defined(name)]
    assert not missing


def defined(name: str) -> bool:
    """Whether a dotted name is a module, or stands at the top of one."""
    parts = name.split(".")
    return module(tuple(parts)) is not None or (
        parts[-1] in top_level(path) if (path := module(tuple(parts[:-1]))) else False
    )


def module(parts: tuple[str, ...]) -> Path | None:
    path = ROOT.joinpath("src", *parts)
    return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)


@cache
def top_level(path: Path) -> frozenset[str]:
    """Names that a file defines or imports at its top."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ImportFrom):
            names |= {alias.asname or alias.name for alias in node.names}
    return frozenset(names)
