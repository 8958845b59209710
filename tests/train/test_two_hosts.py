"""Several processes on one machine train as one run: they take the steps of one host, stop and save together, and go on to the
same bits; what happens to one of them ends none in a hang, and is said in one line."""

import json
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mesoshell
from mesoshell.cli.host_process import LOST, SAID_LOST
from tests.helpers import methods

#: Two processes at once are as many as there are cores.
pytestmark = pytest.mark.xdist_group("hosts")

ROOT = Path(__file__).parents[2]
#: Runs at 2 hosts each way, the second of each stopped by a signal to one host, and gone on with.
BOTH_WAYS: list[dict[str, Any]] = [
    {"name": "jit", "how": "jit"},
    {"name": "jit-cut", "how": "jit", "what": "SIGTERM", "host": 1, "step": 2},
    {"name": "jit-cut", "how": "jit"},
    {"name": "pmap", "how": "pmap"},
    {"name": "pmap-cut", "how": "pmap", "what": "SIGINT", "host": 0, "step": 3, "saves": True},
    {"name": "pmap-cut", "how": "pmap"},
]
SAVED: dict[str, Any] = {"name": "run", "saves": True}
#: Largest difference to one host's run, of a leaf's largest value. All but random draws is float64, and sums come in another
#: order: 3e-16 for a network, 1e-6 for the GAN, which draws its textures in float32, and 2e-7 for textures, which does too.
APART = {"fit": 1e-9, "gan": 1e-5, "nerf_tex": 1e-12, "surface": 1e-12, "atlas": 1e-12, "textures": 2e-6}


def launch(folder: Path, method: str, hosts: int, runs: list[dict[str, Any]], **more: Any) -> list[tuple[int, str]]:
    """Exit status and what was said of each host; of one that was stopped for good nothing is waited for. more: of the plan;
    with `join` the first host alone is started."""
    data = next(p for p in (folder / "data").iterdir() if p.name in ("packed", "set", "ball", "noise.npz", "many"))
    plan = {"port": free_port(), "hosts": hosts, "method": method, "data": str(data), "folder": str(folder)}
    plan |= {"compiled": str(folder / "programs"), "runs": runs}
    (folder / "plan.json").write_text(json.dumps(plan | more))
    command = [sys.executable, "-m", "tests.helpers.hosts_at_work", str(folder / "plan.json")]
    frozen = runs[-1]["host"] if runs[-1].get("what") == "SIGSTOP" else None
    return together([[*command, str(i)] for i in range(1 if "join" in more else hosts)], folder, frozen)


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("localhost", 0))
        return free.getsockname()[1]


def together(commands: list[list[str]], folder: Path, frozen: int | None = None) -> list[tuple[int, str]]:
    path = os.pathsep.join(map(str, [Path(mesoshell.__file__).parent.parent, ROOT]))
    env = os.environ | {"PYTHONPATH": path, "JAX_PLATFORMS": "cpu", "XDG_CACHE_HOME": str(folder / "cache")}
    processes = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=env, cwd=folder)
        for command in commands
    ]
    try:
        return [
            (process.returncode, said)
            for i, process in enumerate(processes)
            if i != frozen
            for said in [process.communicate(timeout=900)[0]]
        ]
    finally:
        for process in processes:
            process.kill()
            process.wait()
            if process.stdout:
                process.stdout.close()


def prepared(folder: Path, method: str) -> Path:
    folder.mkdir()
    methods.write(method, folder / "data")
    return folder


def same(a: list[np.ndarray], b: list[np.ndarray]) -> bool:
    return len(a) == len(b) and all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def apart(a: list[np.ndarray], b: list[np.ndarray]) -> float:
    """Largest difference of two states, of the largest value of each leaf."""
    pairs = [(x.astype(float), y.astype(float)) for x, y in zip(a, b, strict=True) if x.size]
    return max(float(np.abs(x - y).max() / max(np.abs(x).max(), 1e-9)) for x, y in pairs)


def checkpoints(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "checkpoints").iterdir())


def rows(folder: Path) -> list[float]:
    return [json.loads(line)["kimg"] for line in (folder / "log.jsonl").read_text().splitlines()]


#: The one that compiles soonest each time. A step of the others on several devices of one host is slow, too.
METHODS = [
    method if method == "nerf_tex" else pytest.param(method, marks=pytest.mark.slow) for method in methods.CONFIGS
]


@pytest.fixture(scope="module", params=METHODS)
def alone(request, tmp_path_factory) -> tuple[str, Path, list[list[np.ndarray]]]:
    """A method, and of one host the states after a run, after one that Ctrl-C stopped, and when that had gone on; and, in the
    folder, a run that was killed while it trained."""
    folder = prepared(tmp_path_factory.mktemp("alone") / request.param, request.param)
    cut = {"name": "cut", "what": "SIGINT", "host": 0, "step": 3}
    killed = {"name": "killed", "what": "SIGKILL", "host": 0, "step": 4, "saves": True}
    ((status, said),) = launch(folder, request.param, 1, [{"name": "whole"}, cut, {"name": "cut"}, killed])
    assert status == 137 and said.endswith("ended by SIGKILL\n"), said
    return request.param, folder, [methods.kept(folder / f"{i}.0.npz") for i in range(3)]


@pytest.mark.slow
def test_one_host_goes_on_to_the_same_bits_after_an_interrupt_and_a_kill(alone) -> None:
    method, folder, (whole, stopped, resumed) = alone
    assert (methods.counted(stopped), methods.counted(whole)) == (3, methods.STEPS)
    assert same(whole, resumed)
    left = set(checkpoints(folder / "killed"))
    assert left >= {"1", "2"} and not left & {"4", "5", "6"}
    (folder / "killed" / "checkpoints" / "9.orbax-checkpoint-tmp").mkdir()  # what a writer leaves that is killed
    ((status, said),) = launch(folder, method, 1, [{"name": "killed"}])
    assert status == 0, said
    assert same(whole, methods.kept(folder / "0.0.npz"))
    assert checkpoints(folder / "killed")[-1] == "6" and rows(folder / "killed") == rows(folder / "whole")


@pytest.mark.parametrize("hosts", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_hosts_take_the_steps_of_one_and_go_on_to_the_same_bits(alone, tmp_path, hosts: int) -> None:
    method, _, (one, stopped, went_on) = alone
    assert methods.counted(stopped) == 3 and same(one, went_on)
    here = prepared(tmp_path / "together", method)
    ended = launch(here, method, hosts, BOTH_WAYS)
    assert [status for status, _ in ended] == [0] * hosts, ended
    for first, stop in ((0, 3), (3, 4)):
        whole, cut, resumed = ([methods.kept(here / f"{first + k}.{h}.npz") for h in range(hosts)] for k in range(3))
        assert apart(one, whole[0]) <= APART[method]
        assert all(methods.counted(state) == stop for state in cut)
        assert all(same(whole[0], state) for state in [*whole, *resumed])
    (end,) = rows(here / "jit")
    assert checkpoints(here / "jit-cut") == ["3", "6"] and rows(here / "jit-cut") == [end / 2, end]


@pytest.fixture
def network(tmp_path) -> Path:
    """A folder with data of the method that compiles soonest."""
    return prepared(tmp_path / "network", "nerf_tex")


@pytest.mark.slow
def test_a_host_is_killed_and_all_go_on_until_a_disk_is_full(network) -> None:
    """Slow checkpoints hold up, and change nothing."""
    (first, said), (second, _) = launch(network, "nerf_tex", 2, [SAVED | {"what": "SIGKILL", "host": 1, "step": 3}])
    assert (first, second) == (LOST, 137) and len(said.splitlines()) == 1, said
    slow = [SAVED | {"name": f"slow{host}", "what": "slow", "host": host} for host in (0, 1)]
    full = SAVED | {"name": "full", "what": "full", "host": 0, "step": 3}
    (first, said), (second, other) = launch(network, "nerf_tex", 2, [SAVED, {"name": "whole"}, *slow, full])
    assert (first, second) == (2, LOST)
    states = [methods.kept(network / f"{run}.{host}.npz") for run in range(4) for host in (0, 1)]
    assert all(same(states[0], state) for state in states) and rows(network / "run") == rows(network / "whole")
    assert checkpoints(network / "slow0") == ["4", "5", "6"] and checkpoints(network / "full") == ["1", "2"]
    assert said == f"mesoshell: {network}/full/checkpoints: cannot be written: No space left on device\n"
    assert len(other.splitlines()) == 1


@pytest.mark.slow
def test_the_first_host_is_gone_with_all_its_processes(network) -> None:
    (first, _), (second, said) = launch(network, "nerf_tex", 2, [SAVED | {"what": "parent", "host": 0, "step": 3}])
    assert (first, second) == (-9, LOST) and len(said.splitlines()) == 1, said
    assert "lost: " in said or ": host 0 was lost, " in said  # whichever notices first: a sum over hosts, or JAX


@pytest.mark.slow
def test_a_host_that_is_silent_is_lost_after_a_while(network) -> None:
    """It neither answers nor closes what it holds open, as after a cut of the network."""
    runs = [SAVED | {"what": "SIGSTOP", "host": 1, "step": 3}]
    ((status, said),) = launch(network, "nerf_tex", 2, runs, quick=5)
    assert status == LOST and said == f"mesoshell: {network}: {SAID_LOST.replace('a host', 'host 1')}\n"


@pytest.mark.slow  # a host that is lost later is, above
def test_a_host_that_does_not_come_is_not_waited_for_for_ever(network) -> None:
    ((status, said),) = launch(network, "nerf_tex", 2, [SAVED], join=3)
    assert status == LOST and said == f"mesoshell: {network}: not all hosts came in time\n"


EXPERIMENT = """
from dataclasses import replace
from mesoshell.train.nerf_tex.network import NerfTexConfig
from mesoshell.train.gan.presets import TINY
picture = replace(TINY.picture, size=8, samples=4)
config = NerfTexConfig(picture, (4,), (4,), octaves=1, batch=4, kimg=0.012, seeded=True)
"""


def commanded(network: Path, *data: Path) -> list[tuple[int, str]]:
    """What becomes of `mesoshell train` on as many hosts as are given data."""
    (network / "e.py").write_text(EXPERIMENT)
    port, ways = free_port(), []
    for host, folder in enumerate(data):
        given = ["train", "e.py", "--data", str(folder), "--run", "run", "--parallel", "pmap"]
        given += ["--coordinator", f"localhost:{port}", "--hosts", str(len(data)), str(host)]
        ways.append([sys.executable, "-c", "from mesoshell.cli.main import main; main()", *given])
    return together(ways, network)


@pytest.mark.slow
def test_the_command_trains_on_two_hosts(network) -> None:
    ended = commanded(network, *2 * [network / "data" / "packed"])
    assert [status for status, _ in ended] == [0, 0], ended
    assert all(said.endswith("run: 0.012 kimg\n") for _, said in ended)
    run = network / "run"
    assert checkpoints(run) == ["3"] and rows(run) == [0.012]
    assert len(list((run / "snapshots").iterdir())) == 1 and (run / "report.html").exists()


@pytest.mark.slow
def test_the_command_says_that_a_host_is_lost(network) -> None:
    """One of them has a dataset of its own, with a pixel that is not finite."""
    bad = Path(shutil.copytree(network / "data" / "packed", network / "bad"))
    shard = np.load(next((bad / "shards").iterdir()))
    np.save(next((bad / "shards").iterdir()), np.where(np.arange(4) == 3, shard, np.nan).astype(shard.dtype))
    ended = commanded(network, network / "data" / "packed", bad)
    assert [status for status, _ in ended] == [LOST, 2], ended
    assert ended[0][1] == f"mesoshell: run: {SAID_LOST}\n" and "NaN or infinite" in ended[1][1]
    assert checkpoints(network / "run") == []
