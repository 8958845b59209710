"""What baking holds in memory does not depend on the extent: a tile with its halo, and never the texture.

Counted is anonymous memory (RssAnon): the pages of mapped files are on a disk, and belong to the system, not to us. The
allocator keeps little for itself, which would blur the figure: one arena, and what is large goes back at once.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
ALLOCATOR = {"MALLOC_ARENA_MAX": "1", "MALLOC_MMAP_THRESHOLD_": "65536"}
#: Of the bytes that the larger texture has more of, how many may be held more: 1% was seen.
SHARE = 0.05
#: Texels a side: to compile everything; a texture; one of four times its size.
SIDES = (512, 1024, 2048)


@pytest.mark.slow
@pytest.mark.usefixtures("optimised")
def test_four_times_the_texture_needs_no_more_memory(tmp_path: Path) -> None:
    sizes = ["--texels", "256", "--base", "512", "--most", "4", "--folder", str(tmp_path), "--engines"]
    command = [sys.executable, "-m", "benchmarks.extent", "--sides", *map(str, SIDES), *sizes]
    done = subprocess.run(command, cwd=ROOT, env=os.environ | ALLOCATOR, capture_output=True, text=True, check=True)
    rows = [[float(x.replace(",", "")) for x in line.strip("| ").split("|")] for line in done.stdout.splitlines()[-3:]]
    (side, _, _, small, written), (other, _, _, large, more) = rows[1:]
    assert (side, other) == SIDES[1:] and more > 3.9 * written > 300, "the textures are there, and of a size that tells"
    assert large - small < SHARE * (more - written)
    assert not list(tmp_path.iterdir()), "what was written is removed"
