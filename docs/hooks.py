"""What the site makes of the program when it is built: help and settings, the library's names, equations as MathML."""

import contextlib
import html
import io
import os
import re
from types import ModuleType
from typing import Any

from latex2mathml.converter import convert

import mesoshell
from mesoshell.cli.main import main
from mesoshell.render.quality import PRESETS, SETTINGS, range_of

#: Columns of the commands' help.
WIDTH = "100"
_EQUATION = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Names of the library stand for where they are defined; two pages of the reference are written here."""
    markdown = re.sub(r"^::: mesoshell\.(\w+)$", lambda found: described(found[1]), markdown, flags=re.MULTILINE)
    written = {"reference/cli.md": lambda: "".join(commands([])), "reference/settings.md": settings}
    return markdown + written.get(page.file.src_uri, str)()


def on_page_content(content: str, **_: Any) -> str:
    """Equations as MathML, which browsers draw without a script."""
    return _EQUATION.sub(lambda found: equation(html.unescape(found[2]), found[1] == "div"), content)


def described(name: str) -> str:
    """What mkdocstrings is asked for a name of the library, under the name that users write."""
    return f"::: {home(name)}\n    options:\n      heading: ms.{name}\n      toc_label: {name}"


def home(name: str) -> str:
    """Where a name of `import mesoshell` is defined; a room itself, or, of a room that is a function too, the function."""
    thing = getattr(mesoshell, name)
    if isinstance(thing, ModuleType):
        if not callable(thing):
            return thing.__name__
        thing = thing.__call__
    return f"{thing.__module__}.{thing.__qualname__}"


def equation(latex: str, alone: bool) -> str:
    return convert(latex.strip(), display="block" if alone else "inline")


def settings() -> str:
    """A table of the fields of a quality."""
    heads = ["setting", "what it is", "values", *PRESETS, "cheaper values bias"]
    rows = [heads, ["---"] * len(heads)]
    for name, about in SETTINGS.items():
        used = f" ({about.engine} only)" if about.engine else ""
        presets = [str(getattr(preset, name)) for preset in PRESETS.values()]
        rows.append([f"`{name}`{used}", about.meaning, range_of(name), *presets, about.bias or "nothing"])
    return "\n" + "".join(f"| {' | '.join(row)} |\n" for row in rows)


def commands(verbs: list[str]) -> list[str]:
    """A section for a verb and for each verb below it: what `--help` prints."""
    text = helped(verbs)
    below = re.search(r"\{([\w,-]+)\}$", text.splitlines()[0])
    title = " ".join(["mesoshell", *verbs])
    section = f"\n\n{'#' * (2 + len(verbs[1:]))} {title}\n\n```text\n{text.strip()}\n```\n"
    more = [commands([*verbs, verb]) for verb in below[1].split(",")] if below else []
    return [section, *(line for part in more for line in part)]


def helped(verbs: list[str]) -> str:
    os.environ["COLUMNS"] = WIDTH
    with contextlib.redirect_stdout(io.StringIO()) as printed, contextlib.suppress(SystemExit):
        main([*verbs, "--help"])
    return "\n".join(line.rstrip() for line in printed.getvalue().splitlines())
