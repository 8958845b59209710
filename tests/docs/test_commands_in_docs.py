"""The commands of docs/ and README.md: each verb is there, and takes the options that it is given."""

import contextlib
import io
import re
from functools import cache
from pathlib import Path

import pytest

from mesoshell.cli.main import main

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
#: A command: in an indented block, to the end of its line or of the line it is continued on; or all of a piece of code.
COMMAND = re.compile(r"(?:^ {4}(?:srun )?|`|\")(?:\.venv/bin/)?mesoshell ((?:[^`\n\\]|\\\n)+)", re.MULTILINE)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_commands_are_there(page: Path) -> None:
    wrong = []
    for command in COMMAND.findall(page.read_text()):
        words = command.split("  #")[0].replace("\\\n", " ").split()
        if not re.fullmatch(r"[a-z]+", words[0]):
            continue  # VERB, --help
        verb = tuple(words[: 2 if words[0] in ("dataset", "judge", "atlas") else 1])
        text = helped(verb)
        wrong += [command] if text is None else []
        wrong += [
            f"{' '.join(verb)} {x}" for x in re.findall(r"(?<!\S)--[a-z-]+", " ".join(words)) if x not in (text or "")
        ]
    assert not wrong


@cache
def helped(verb: tuple[str, ...]) -> str | None:
    """What the verb's help says; nothing if there is no such verb, of which the parser prints the help above it."""
    with contextlib.redirect_stdout(io.StringIO()) as printed, contextlib.suppress(SystemExit):
        main([*verb, "--help"])
    text = printed.getvalue()
    return text if text.startswith(f"usage: mesoshell {' '.join(verb)} ") else None
