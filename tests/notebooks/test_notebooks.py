"""Every notebook runs from top to bottom, in a process of its own; the longest in the slow tests, and in the others
what it imports and calls is there."""

import ast
import os

import jax
import pytest

import mesoshell
import mesoshell.pathtracer  # before Mitsuba, as notebooks have it
from notebooks.execute import FOLDER, NO_BLENDER, NOTEBOOKS, can_run, execute

#: Those that take longer to run than to compile.
OPTIMISED = {"atlas.py", "corner_tiles.py"}
#: Those that train, or make many textures; what they show has tests of its own.
LONG = {"atlas.py", "generator.py", "silhouette.py"}


@pytest.mark.apart
@pytest.mark.filterwarnings("default")  # of Jupyter's own
@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in LONG else n for n in NOTEBOOKS])
def test_it_runs(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if not can_run(name):
        pytest.skip(NO_BLENDER)
    if name in OPTIMISED:
        monkeypatch.delenv("JAX_DISABLE_MOST_OPTIMIZATIONS")
    for option in ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs"):
        monkeypatch.setitem(os.environ, option.upper(), str(getattr(jax.config, option)))
    assert execute(name) > 0


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_what_it_imports_is_there(name: str) -> None:
    """And what it calls `ms.…`, by its name."""
    tree = ast.parse((FOLDER / name).read_text())
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    names: dict = {}
    exec(compile(ast.Module(imports, []), name, "exec"), names)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "ms":
            assert node.attr in mesoshell.__all__
