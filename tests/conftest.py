"""Test set-up: shapes are checked with beartype, ranks and dtypes must match exactly, warnings are errors, no test is timed.
JAX optimises little, since tests compile more than they compute (`optimised` is for those that do not), and forgets now and
then what it has compiled: gigabytes in the end. Python looks for cycles rarely, since what JAX traces makes millions of
objects and few cycles: then is soon enough. The path tracer's functions are left alone: Dr.Jit rewrites their source,
and their arrays carry no shapes."""

import contextlib
import gc
import itertools
import os
import pkgutil

from jaxtyping import install_import_hook

import mesoshell

CHECKED = [f"mesoshell.{part.name}" for part in pkgutil.iter_modules(mesoshell.__path__) if part.name != "pathtracer"]
install_import_hook(CHECKED, "beartype.beartype")

import jax  # noqa: E402  (the hook must come first)
import jax.numpy as jnp  # noqa: E402
import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

from data_gen.tiles import COLOURS  # noqa: E402
from mesoshell.io.bundle import Bundle, Parameter  # noqa: E402
from mesoshell.shell.material.decoder import init_decoder  # noqa: E402
from mesoshell.train.export import to_bundle  # noqa: E402
from mesoshell.train.fit.state import Common, FitConfig  # noqa: E402

gc.freeze()
gc.set_threshold(100_000, 50, 100)
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_traceback_in_locations_limit", 0)
jax.config.update("jax_disable_most_optimizations", True)
os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"  # in processes of their own too
if jax.__version_info__ < (
    0,
    11,
):  # a flag that an XLA does not know ends it; with these, compiling takes half the time
    faster = "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {faster}".strip()


@pytest.fixture(scope="session", autouse=True)
def _compiled_once(tmp_path_factory):
    """Programs that several tests compile are compiled once a run, whichever of its processes comes first; small ones anew,
    which takes no longer than to keep them."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if base.name.startswith("popen-") else base
    jax.config.update("jax_compilation_cache_dir", str(shared / "xla"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """A file's tests share what they compile: one process runs them, unless a mark says otherwise."""
    for item in items:
        if item.get_closest_marker("xdist_group") is None and item.get_closest_marker("apart") is None:
            item.add_marker(pytest.mark.xdist_group(item.nodeid.split("::")[0]))


_FILES = itertools.count(1)


@pytest.fixture(scope="module", autouse=True)
def _forgotten_after():
    yield
    if next(_FILES) % 8 == 0:
        jax.clear_caches()
        gc.unfreeze()
    gc.collect()  # what a file left open is told of there, and not in another file
    gc.freeze()


def _optimise(on: bool) -> None:
    """In processes of their own too."""
    jax.config.update("jax_disable_most_optimizations", not on)
    os.environ.pop("JAX_DISABLE_MOST_OPTIMIZATIONS", None)
    if not on:
        os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"


@pytest.fixture(scope="module")
def optimised():
    """For programs that take longer to run than to compile."""
    jax.clear_caches()
    _optimise(True)
    yield
    _optimise(False)


@pytest.fixture(scope="module")
def compiled_soon(optimised):
    """A context, where else programs are optimised, for a few that take longer to compile than to run."""

    @contextlib.contextmanager
    def within():
        _optimise(False)
        yield
        jax.clear_caches()
        _optimise(True)

    return within


@pytest.fixture(scope="session")
def tiny_bundle() -> Bundle:
    """A random material, small enough to make and to render in seconds, with one parameter `dryness` in [0, 2]."""
    return _rough(tiles=0)


@pytest.fixture(scope="session")
def tiled_bundle() -> Bundle:
    """The same on corner tiles."""
    return _rough(tiles=4)


def _rough(tiles: int) -> Bundle:
    optimised = "JAX_DISABLE_MOST_OPTIMIZATIONS" not in os.environ
    _optimise(False)
    try:
        return _made(FitConfig(texels=4, channels=4, height_rows=4, octaves=1, trunk=(8, 8), head=(8,), tiles=tiles))
    finally:
        _optimise(optimised)


def _made(config: FitConfig) -> Bundle:
    keys = jax.random.split(jax.random.key(0), 3)  # as a fit begins, but rough
    feature = 2 * jax.random.normal(keys[0], (config.side, config.side, 4), jnp.float32)
    height = 2 * jax.random.normal(keys[1], (4, 1, 4), jnp.float32)
    decoder = init_decoder(keys[2], 4 + 1 + 2 + 1, (8, 8), (8,))._replace(scale=jnp.asarray(400.0))
    dryness = Parameter("dryness", "alpha", (0.0, 2.0), 0.5, "1", "how dry")
    colours = COLOURS if config.tiles else None
    return to_bundle(config, Common(height, decoder), feature, (dryness,), provenance={}, colours=colours)
