"""Every notebook runs from top to bottom, in a process of its own."""

import os

import jax
import pytest

from notebooks.execute import NO_BLENDER, NOTEBOOKS, can_run, execute

#: Those that take longer to run than to compile.
OPTIMISED = {"accuracy_and_time.py", "atlas.py", "corner_tiles.py", "film.py", "filtering.py"}


@pytest.mark.apart
@pytest.mark.filterwarnings("default")  # of Jupyter's own
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_runs(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if not can_run(name):
        pytest.skip(NO_BLENDER)
    if name in OPTIMISED:
        monkeypatch.delenv("JAX_DISABLE_MOST_OPTIMIZATIONS")
    for option in ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs"):
        monkeypatch.setitem(os.environ, option.upper(), str(getattr(jax.config, option)))
    assert execute(name) > 0
