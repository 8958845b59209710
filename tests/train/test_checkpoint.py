"""Checkpoints: a torn one gives way to the one before, leftovers of a killed writer go, a full disk is said."""

import json
import resource
import shutil
import signal
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
import pytest

from mesoshell.errors import InputError
from mesoshell.train.checkpoint import KEPT, Checkpoints
from mesoshell.train.run_config import forget_after

#: Where a read fails, orbax closes its event loop under others that are under way: the collector hears of these, a test later.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

TREE = {"a": jnp.arange(1000.0), "step": jnp.zeros((), jnp.int32), "c": [jnp.arange(9e4).reshape(300, 300)]}


def at(step: int) -> dict:
    return jax.tree.map(lambda x: x + step, TREE)


def same(a, b) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "checkpoints"
    with Checkpoints(folder) as checkpoints:
        for step in range(1, KEPT + 2):
            checkpoints.save(step, at(step))
    return folder


@pytest.fixture
def folder(saved, tmp_path) -> Path:
    return Path(shutil.copytree(saved, tmp_path / "checkpoints"))


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def tear(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def largest(step: Path) -> Path:
    return max((path for path in step.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size)


def test_the_newest_few_are_kept_and_read(folder) -> None:
    assert names(folder) == ["2", "3", "4"]
    with Checkpoints(folder) as checkpoints:
        step, found = checkpoints.newest(TREE)  # type: ignore[misc]
    assert step == checkpoints.last == 4 and same(found, at(4))


def test_what_an_older_version_wrote_and_arrays_of_a_host_are_read(tmp_path) -> None:
    with ocp.CheckpointManager(tmp_path / "old", options=ocp.CheckpointManagerOptions(max_to_keep=3)) as manager:
        manager.save(7, args=ocp.args.StandardSave(at(7)))
    with Checkpoints(tmp_path / "many") as checkpoints:
        checkpoints.save(7, jax.tree.map(np.asarray, at(7)))
    for name in ("old", "many"):
        with Checkpoints(tmp_path / name) as checkpoints:
            step, found = checkpoints.newest(TREE)  # type: ignore[misc]
        assert step == 7 and same(found, at(7)) and all(isinstance(x, jax.Array) for x in jax.tree.leaves(found))


#: Which files, and whether they are gone or torn. A test each of the three of them, and one of what is gone.
TORN = [
    ("d", False),
    ("manifest.ocdbt", True),
    ("_METADATA", False),
    pytest.param("d", True, marks=pytest.mark.slow),
    pytest.param("manifest.ocdbt", False, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("which", "gone"), TORN)
def test_a_torn_one_gives_way_to_the_one_before(folder, which: str, gone: bool) -> None:
    files = [path for path in (folder / "4" / "default").rglob("*") if path.is_file()]
    for path in files:
        if path.name == which or (which == "d" and path.parent.name == "d"):
            path.unlink() if gone else tear(path)
    said = r"/4: cannot be read; using the checkpoint before it"
    with pytest.warns(UserWarning, match=said), Checkpoints(folder) as checkpoints:
        step, found = checkpoints.newest(TREE)  # type: ignore[misc]
        assert step == checkpoints.last == 3 and same(found, at(3))
        checkpoints.save(4, at(4))  # the run comes by again
    assert names(folder) == ["2", "3", "4", "unreadable.4"]
    with Checkpoints(folder) as checkpoints:
        assert same(checkpoints.newest(TREE), (4, at(4)))


def test_if_none_can_be_read_nothing_begins_anew_and_nothing_is_moved(folder) -> None:
    for step in names(folder):
        tear(largest(folder / step))
    said = r"checkpoints: none of its checkpoints can be read; of 4: "
    with pytest.raises(InputError, match=said), Checkpoints(folder) as checkpoints:
        checkpoints.newest(TREE)
    assert names(folder) == ["2", "3", "4"]


def test_a_state_of_other_shapes_is_refused(folder) -> None:
    with pytest.raises(InputError, match="none of its checkpoints can be read"), Checkpoints(folder) as checkpoints:
        checkpoints.newest(TREE | {"a": jnp.arange(999.0)})
    assert names(folder) == ["2", "3", "4"]


def test_leftovers_go_but_not_under_a_reader(folder, tmp_path) -> None:
    left = folder / "5.orbax-checkpoint-tmp"
    shutil.copytree(folder / "4", left)
    tear(largest(folder / "4"))
    with pytest.warns(UserWarning, match="cannot be read"), Checkpoints(folder, reading=True) as checkpoints:
        assert same(checkpoints.newest(TREE), (3, at(3)))
    assert names(folder) == ["2", "3", "4", left.name]
    with Checkpoints(tmp_path / "none", reading=True) as checkpoints:
        assert checkpoints.newest(TREE) is None
    assert not (tmp_path / "none").exists()
    with Checkpoints(folder):
        pass
    assert names(folder) == ["2", "3", "4"]


def test_a_full_disk_is_one_line_and_what_was_there_stays(folder) -> None:
    """Of files that may not grow beyond a size, as of a disk, a write returns an error."""
    noise = np.random.default_rng(0).normal(size=1 << 19)  # does not compress
    limit, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        said = r"checkpoints: cannot be written: "
        with pytest.raises(InputError, match=said) as caught, Checkpoints(folder) as checkpoints:
            resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, limit[1]))
            checkpoints.save(5, TREE | {"c": [noise]})
            checkpoints.finish()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, handler)
    assert "\n" not in str(caught.value)
    with Checkpoints(folder) as checkpoints:
        assert same(checkpoints.newest(TREE), (4, at(4)))
    assert names(folder) == ["2", "3", "4"]


def test_rows_beyond_a_checkpoint_and_a_torn_last_one_are_forgotten(tmp_path) -> None:
    path = tmp_path / "log.jsonl"
    forget_after(path, "kimg", 1.0)
    assert not path.exists()
    lines = [json.dumps({"kimg": k / 10, "loss": k}) for k in range(1, 5)]
    path.write_text("\n".join(lines) + '\n{"kimg": 0.5, "lo')
    forget_after(path, "kimg", 0.3)
    assert path.read_text() == "\n".join(lines[:3]) + "\n"
