"""Render the gallery of docs/index.md anew: python docs/gallery.py [NAME …]

Each picture of the page that lies in images/gallery/ is what the command below it writes.
"""

import re
import shlex
import shutil
import sys
from pathlib import Path

from mesoshell.cli.main import main

PAGE, PICTURES, OUT = Path("docs/index.md"), Path("docs/images/gallery"), Path("out/gallery")
SHOT = re.compile(r"images/gallery/(\w+)\.png\)\n+`mesoshell ([^`]+)`")


def shots() -> dict[str, list[str]]:
    """The words of each picture's command, by the picture's name."""
    return {name: shlex.split(command) for name, command in SHOT.findall(PAGE.read_text())}


def render(name: str, words: list[str]) -> None:
    """Where --out is to be; what else it writes stays there."""
    path = OUT / f"{name}.png"
    main([*words, "--out", str(path)])
    PICTURES.mkdir(exist_ok=True)
    shutil.copy(path, PICTURES / path.name)


if __name__ == "__main__":
    unknown = set(sys.argv[1:]) - shots().keys()
    if unknown:
        sys.exit(f"{PAGE}: no picture {', '.join(sorted(unknown))}")
    for name, words in shots().items():
        if name in (sys.argv[1:] or shots()):
            render(name, words)
