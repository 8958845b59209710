"""What docstrings line up by lines keeps them on the site: notation in columns, and fields as `name: what it is`."""

import re
from typing import Any

import griffe

_COLUMNS, _FIELD = re.compile(r"\S {3,}\S"), re.compile(r"^(\w+): ")


class Notation(griffe.Extension):
    """Turns paragraphs of columns into blocks that are left as they are, and paragraphs of fields into lists."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = "\n\n".join(kept(part) for part in obj.docstring.value.split("\n\n"))


def kept(paragraph: str) -> str:
    lines = paragraph.splitlines()
    if sum(bool(_COLUMNS.search(line)) for line in lines) > 1:
        return "\n".join(["```text", *lines, "```"])
    if len(lines) > 1 and all(_FIELD.match(line) or line.startswith("    ") for line in lines):
        return "\n".join(_FIELD.sub(r"- `\1`: ", line) for line in lines)
    return paragraph
