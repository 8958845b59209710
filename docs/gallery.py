"""Render the gallery of docs/index.md anew: python docs/gallery.py [NAME …]

Each picture of the page that lies in images/gallery/ is what the command below it writes.
"""

import re
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from mesoshell.cli.main import main

PAGE, PICTURES, OUT = Path("docs/index.md"), Path("docs/images/gallery"), Path("out/gallery")
SHOT = re.compile(r"images/gallery/(\w+)\.png\)\n+`mesoshell ([^`]+)`")


def shots() -> dict[str, list[str]]:
    """The words of each picture's command, by the picture's name."""
    return {name: shlex.split(command) for name, command in SHOT.findall(PAGE.read_text())}


def render(name: str, words: list[str]) -> None:
    """Where --out is to be; what else it writes stays there. Of a film all frames in one picture, two side by side."""
    path = OUT / f"{name}.png"
    PICTURES.mkdir(exist_ok=True)
    if words[0] != "film":
        main([*words, "--out", str(path)])
        shutil.copy(path, PICTURES / path.name)
        return
    main([*words, "--out", str(OUT / name)])
    frames = [np.asarray(Image.open(x)) for x in sorted((OUT / name).glob("*.png"))]
    assert len(frames) % 2 == 0, f"{name}: an even number of frames fills the rows"
    rows = [np.concatenate(frames[k : k + 2], axis=1) for k in range(0, len(frames), 2)]
    Image.fromarray(np.concatenate(rows)).save(PICTURES / path.name, optimize=True)


if __name__ == "__main__":
    unknown = set(sys.argv[1:]) - shots().keys()
    if unknown:
        sys.exit(f"{PAGE}: no picture {', '.join(sorted(unknown))}")
    for name, words in shots().items():
        if name in (sys.argv[1:] or shots()):
            render(name, words)
