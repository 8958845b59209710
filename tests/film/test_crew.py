"""Frames by other processes, and by a cluster, are the frames of this one; what goes wrong there is said here."""

import os
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import mesoshell as ms
from mesoshell.cli.main import main
from mesoshell.errors import InputError
from mesoshell.film import crew as crews
from mesoshell.film.cluster import on_cluster
from mesoshell.film.crew import alone, crew_of
from mesoshell.film.frame import Made, Shot, Task
from mesoshell.film.processes import _Worker, in_processes
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.render.quality import PRESETS
from mesoshell.scene.materials import Material
from mesoshell.scene.settle import settle

MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
DRAFT: dict[str, Any] = {"quality": "draft", "samples": 4}


@pytest.fixture(autouse=True)
def _no_cache_at_home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture
def scene(tiny_bundle: Bundle) -> ms.Scene:
    return ms.Scene(MESH, Material("tiny", tiny_bundle), scale=0.4, size=(16, 12))


@pytest.fixture
def shot(scene: ms.Scene) -> Shot:
    return Shot(settle(scene), PRESETS["draft"].with_changes(samples=4, density="network"), "jax")


class Ends:
    """Read from a pickle, it ends the process. code: exit status, or minus a signal."""

    def __init__(self, code: int):
        self.code = code

    def __reduce__(self) -> tuple:
        end = f"os._exit({self.code})" if self.code >= 0 else f"os.kill(os.getpid(), {-self.code})"
        return exec, (f"import os; {end}",)


def ignore(share: float) -> None:
    """Shows nothing."""


def tasks(folder: Path, *changes: dict[str, Any]) -> tuple[Iterator[Task], int]:
    """And how many they are."""
    return (Task(k, change, folder / f"{k}.png") for k, change in enumerate(changes)), len(changes)


def test_processes_make_the_frames_that_this_one_makes(scene: ms.Scene, tmp_path: Path):
    here = ms.film(scene, tmp_path / "here", orbit=4, **DRAFT)
    shown: list[float] = []
    there = ms.film(
        scene, tmp_path / "there", orbit=4, workers=2, progress=lambda share, what: shown.append(share), **DRAFT
    )
    assert [p.read_bytes() for p in there.frames] == [p.read_bytes() for p in here.frames]
    assert there.flicker == here.flicker and there.notes == here.notes
    assert shown == sorted(shown) and shown[-1] == 1
    there.frames[1].unlink()
    again = ms.film(scene, tmp_path / "there", orbit=4, **DRAFT)  # alone: it is the same film
    assert again.frames[1].read_bytes() == here.frames[1].read_bytes() and again.seconds[0] == there.seconds[0]


@pytest.mark.slow
def test_a_cluster_makes_the_frames_that_this_process_makes(
    shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    changes = [{"thickness": 0.1 + 0.02 * k} for k in range(3)]
    monkeypatch.chdir(tmp_path)  # a relative path is made absolute
    here = {"dashboard_address": None, "host": "127.0.0.1", "silence_logs": 50}
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, **here) as machines:
        made = list(on_cluster(machines.scheduler_address)(shot, *tasks(Path("there"), *changes), ignore))
        for change, says in (
            ({"thickness": -1.0}, "thickness: must be positive"),
            ({"nothing": 1}, "scheduler: a frame failed: "),
        ):
            with pytest.raises(InputError, match=says):
                list(on_cluster(machines.scheduler_address)(shot, *tasks(Path("there"), change), ignore))
    assert sorted(x.k for x in made) == [0, 1, 2]
    for k, _ in enumerate(alone(shot, *tasks(Path("here"), *changes), ignore)):
        assert Path(f"there/{k}.png").read_bytes() == Path(f"here/{k}.png").read_bytes()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"thickness": -1.0}, "thickness: must be positive and finite, not -1"),
        ({"params": {"age": Ends(3)}}, "workers: one ended at frame 0: exit status 3"),
        ({"params": {"age": Ends(-9)}}, "workers: one ended at frame 0: SIGKILL; fewer of them take less memory"),
    ],
)
def test_what_goes_wrong_in_a_process_is_said(change: dict[str, Any], says: str, shot: Shot, tmp_path: Path):
    with pytest.raises(InputError, match=says):
        list(in_processes(1)(shot, *tasks(tmp_path, change), ignore))


def test_a_defect_in_a_process_is_one_here(shot: Shot, tmp_path: Path):
    with pytest.raises(RuntimeError, match=r"TypeError: .*unexpected keyword argument 'nothing'"):
        list(in_processes(1)(shot, *tasks(tmp_path, {"nothing": 1}), ignore))


def test_a_film_that_is_stopped_leaves_no_process(shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    begun: list[_Worker] = []
    init = _Worker.__init__

    def counted(self: _Worker, cores: set[int] | None) -> None:
        begun.append(self)
        init(self, cores)

    monkeypatch.setattr(_Worker, "__init__", counted)
    frames = in_processes(2)(shot, *tasks(tmp_path, *[{}] * 50), ignore)
    next(frames)
    frames.close()
    assert [worker._process.poll() for worker in begun] == [-9, -9]
    assert 1 <= len(list(tmp_path.glob("*.png"))) < 50


def test_a_process_ends_when_nobody_asks_it(shot: Shot):
    worker = _Worker(None)
    worker.tell(pickle.dumps(shot))
    assert worker._process.stdin is not None
    worker._process.stdin.close()
    assert worker._process.wait(timeout=60) == 0
    worker.end()


def test_each_process_has_cores_of_its_own():
    from mesoshell.film.processes import _cores

    everyone = os.sched_getaffinity(0)
    shares = [x or set() for x in _cores(len(everyone))]
    assert set().union(*shares) == everyone and all(len(x) == 1 for x in shares)
    assert all(x and x <= everyone for x in _cores(3 * len(everyone)))


def test_a_film_that_is_done_begins_no_process(scene: ms.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Nor one that has no frame to make."""
    begun: list[set[int] | None] = []
    init = _Worker.__init__
    monkeypatch.setattr(_Worker, "__init__", lambda self, cores: begun.append(cores) or init(self, cores))
    made = ms.film(scene, tmp_path / "film", orbit=1, workers=5, **DRAFT)
    assert len(begun) == 1 and begun[0] == os.sched_getaffinity(0)
    assert ms.film(scene, tmp_path / "film", orbit=1, workers=5, **DRAFT).frames == made.frames and len(begun) == 1


def test_frames_that_were_lost_are_made_anew(scene: ms.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """By those who write several before they say so."""
    whole = ms.film(scene, tmp_path / "film", orbit=5, **DRAFT)

    def late(shot: Shot, tasks: Iterator[Task], count: int, show: Any) -> Iterator[Made]:
        yield from list(alone(shot, tasks, count, show))[::-1]

    monkeypatch.setattr(crews, "in_processes", lambda count: late)
    for k in (1, 2):
        whole.frames[k].unlink()
    again = ms.film(scene, tmp_path / "film", orbit=5, workers=2, **DRAFT)
    assert again.flicker == whole.flicker and all(path.exists() for path in again.frames)


def test_a_film_that_was_stopped_before_its_first_frame_leaves_no_record(scene: ms.Scene, tmp_path: Path):
    def stopped(share: float, what: str) -> None:
        if what.startswith("frame"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ms.film(scene, tmp_path / "film", orbit=4, progress=stopped, **DRAFT)
    assert len(ms.film(scene, tmp_path / "film", orbit=2, **DRAFT).frames) == 2


def test_the_command_takes_both(scene: ms.Scene, tiny_bundle: Bundle, tmp_path: Path, capsys: pytest.CaptureFixture):
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    words = ["film", str(MESH), "--material", str(tmp_path / "tiny.npz"), "--orbit", "2", "--size", "16", "12"]
    words += ["--quality", "draft", "--out", str(tmp_path / "film")]
    for more, says in (
        (["--workers", "0"], "--workers: must be at least 1, not 0"),
        (["--workers", "1", "--scheduler", "tcp://127.0.0.1:9"], "--workers: cannot be combined with --scheduler"),
        (["--scheduler", "here"], "--scheduler: here does not answer"),
    ):
        with pytest.raises(SystemExit) as left:
            main([*words, *more])
        assert left.value.code == 2 and says in capsys.readouterr().err and not (tmp_path / "film").exists()
    main([*words, "--workers", "1"])
    assert "2 frames" in capsys.readouterr().out and (tmp_path / "film" / "00001.png").exists()


def test_frames_that_are_not_here_are_told_of(scene: ms.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def elsewhere(shot: Shot, tasks: Iterator[Task], count: int, show: Any) -> Iterator[Made]:
        for task in tasks:
            yield Made(task.k, 1.0, ())

    monkeypatch.setattr(crews, "in_processes", lambda count: elsewhere)
    with pytest.raises(InputError, match="has no frame 0, which a worker made: workers must share the folder"):
        ms.film(scene, tmp_path / "film", orbit=2, workers=1, **DRAFT)


def test_a_crew_is_one_of_three():
    assert crew_of(None, None) is alone
    with pytest.raises(InputError, match="workers: must be at least 1, not 0"):
        crew_of(0, None)
    with pytest.raises(InputError, match="workers: cannot be combined with `scheduler`"):
        crew_of(2, "tcp://127.0.0.1:9")
