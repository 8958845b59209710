"""On a cluster: the same folder, and a worker that dies midway costs nothing."""

import os
import signal
import threading
import time

import pytest

from mesoshell.datasets.blender import cluster as cluster_module
from mesoshell.datasets.blender.render import SHARD, Farm, render_dataset
from mesoshell.errors import InputError
from mesoshell.io.dataset_check import check_dataset
from tests.helpers.stand_ins import STAND_IN, contents, ignore, settings

distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")


@pytest.fixture
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1", silence_logs=50
    ) as cluster:
        yield cluster


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_worker_killed_midway_loses_nothing_and_doubles_nothing(cluster, farm, tmp_path):
    count = 3 * SHARD
    recipe = f"slow=0.03 trace={tmp_path / 'trace'}"
    farm_here = Farm(1, 1, cluster.scheduler_address, STAND_IN)
    victim = next(iter(cluster.workers.values())).pid
    images = tmp_path / "cluster" / "images"

    def kill_midway() -> None:
        while not images.exists() or len(list(images.glob("*.exr"))) < SHARD // 2:
            time.sleep(0.01)
        os.kill(victim, signal.SIGKILL)
        (images / f".000006.exr.{'0' * 16}.partial").touch()  # as if it died while it wrote

    killer = threading.Thread(target=kill_midway)
    killer.start()
    report = render_dataset(settings(recipe), count, tmp_path / "cluster", farm_here, ignore)
    killer.join()
    assert (report.missing, report.faults) == (count, [])
    assert check_dataset(tmp_path / "cluster") == []
    rendered = [int(line) for line in (tmp_path / "trace").read_text().split()]
    assert set(rendered) == set(range(count)) and len(rendered) <= count + 2
    farm(tmp_path / "here", count, recipe, workers=2)
    assert contents(tmp_path / "here") == contents(tmp_path / "cluster")


def test_an_address_where_nobody_is(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster_module, "_PATIENCE", "1s")
    with pytest.raises(InputError, match=r"scheduler: tcp://127\.0\.0\.1:9 does not answer"):
        render_dataset(settings(), 1, tmp_path / "d", Farm(1, 1, "tcp://127.0.0.1:9", STAND_IN), ignore)
    assert not (tmp_path / "d").exists()
