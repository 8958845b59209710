"""docs/tutorials/library.md is true: its blocks run, one after the other, and print what stands beside them."""

import contextlib
import io
import re
import shutil
from pathlib import Path

import jax
import pytest

import mesoshell
from tests.helpers import fog, wearing

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/tutorials/library.md").read_text()
BLOCKS = re.findall(r"^```(python|xml)\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that the page names."""
    made = tmp_path_factory.mktemp("page")
    shutil.copy(ROOT / "tests/data/spot.obj", made)
    shutil.copy(ROOT / "experiments/weave_silhouette.py", made)
    (made / "scene.xml").write_text(next(text for kind, text in BLOCKS if kind == "xml"))
    fog.write(made / "fog", fog.CAMERAS)
    fog.write(made / "fog_unseen", [(2.2, 1.9, 2.0)])
    wearing.write_patches(made / "queries", [wearing.rows(128, k, _answer) for k in range(5)])
    return made


def _answer(q: dict) -> dict:
    return {"alpha": 0.5, "cosine": 0, "rgb": 0.1}


def test_every_block_prints_what_it_says(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    names: dict = {}
    as_users_have_it = jax.numpy_dtype_promotion("standard")
    for block in (text for kind, text in BLOCKS if kind == "python"):
        said = [line for line in block.splitlines() if line.lstrip().startswith("print(")]
        with contextlib.redirect_stdout(io.StringIO()) as printed, as_users_have_it:
            exec(compile(block, "docs/tutorials/library.md", "exec"), names)
        assert printed.getvalue().splitlines() == [line.rpartition("  # ")[2] for line in said]


def test_every_name_of_the_library_stands_on_it() -> None:
    missing = [name for name in mesoshell.__all__ if not re.search(rf"\b{name}\b", PAGE)]
    assert missing == ["__version__"]
