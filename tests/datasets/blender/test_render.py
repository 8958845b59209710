"""A run can be cut, killed and repeated: the folder ends the same, and what fails is named."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mesoshell.datasets.blender import process, shard
from mesoshell.datasets.blender.render import SHARD, Farm, render_dataset
from mesoshell.errors import InputError
from mesoshell.io.dataset import read_dataset
from mesoshell.io.dataset_check import check_dataset
from mesoshell.io.dataset_images import load_images
from mesoshell.io.dataset_writer import Collector, collecting
from tests.helpers.stand_ins import STAND_IN, contents, ignore, settings


def test_the_checkout_is_found_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = process._checkout(Path("data_gen/worker.py"))
    assert found == Path(__file__).resolve().parents[3]


def test_the_folder_is_the_same_bytes_whoever_renders_it(farm, tmp_path):
    for name, workers in (("one", 1), ("three", 3)):
        assert farm(tmp_path / name, 2 * SHARD + 3, workers=workers).faults == []
        assert check_dataset(tmp_path / name) == []
    assert contents(tmp_path / "one") == contents(tmp_path / "three")
    images = load_images(read_dataset(tmp_path / "one"))
    assert (images[:, 0, 0, 0] * 64 - 1).tolist() == list(range(2 * SHARD + 3))


def test_a_larger_count_extends_a_dataset_and_a_smaller_one_changes_nothing(farm, tmp_path):
    farm(tmp_path / "d", 3)
    before = contents(tmp_path / "d")
    report = farm(tmp_path / "d", 5, "grass")
    assert (report.missing, len(report.logs)) == (2, 2)
    after = contents(tmp_path / "d")
    assert json.loads(after["manifest.json"])["count"] == 5
    assert all(after[name] == before[name] for name in before if name.startswith("images"))
    assert farm(tmp_path / "d", 2).missing == 0
    assert contents(tmp_path / "d") == after


def test_an_image_without_a_row_is_kept_and_not_rendered_again(farm, tmp_path):
    trace = tmp_path / "trace"
    farm(tmp_path / "d", 4, f"trace={trace}")
    whole = contents(tmp_path / "d")
    rows = tmp_path / "d" / "samples.jsonl"
    rows.write_text("".join(rows.read_text().splitlines(keepends=True)[:1]) + '{"index": 1, "fi')
    (tmp_path / "d" / "images" / "000003.exr").unlink()
    (tmp_path / "d" / "images" / ".000003.exr.0123456789abcdef.partial").write_bytes(b"half")
    report = farm(tmp_path / "d", 4, f"trace={trace}")
    assert (report.missing, len(report.logs)) == (3, 1)
    assert contents(tmp_path / "d") == whole
    assert trace.read_text().split() == ["0", "1", "2", "3", "3"]


def test_a_crash_and_a_fault_name_their_sample_and_the_rest_goes_on(farm, tmp_path):
    said = []
    report = farm(tmp_path / "d", 7, "crash=2 fault=4", show=lambda finished, missing, fault: said.append(fault))
    assert [(fault.index, fault.reason) for fault in report.faults] == [
        (2, "Blender was ended by signal 11: Fatal: out of luck"),
        (4, "no luck"),
    ]
    assert [fault for fault in said if fault] == report.faults and len(said) == 8
    assert [sample.index for sample in read_dataset(tmp_path / "d").samples] == [0, 1, 3, 5, 6]
    assert check_dataset(tmp_path / "d") == [f"{tmp_path / 'd' / 'samples.jsonl'}: has no row for samples 2, 4"]


def test_a_process_that_leaves_between_two_samples_costs_one(farm, tmp_path):
    report = farm(tmp_path / "d", 4, "leave=1")
    assert [(fault.index, fault.reason) for fault in report.faults] == [
        (2, "Blender ended with exit status 1: had enough")
    ]
    assert farm(tmp_path / "d", 4, "leave=1").missing == 1
    assert check_dataset(tmp_path / "d") == []


def test_a_process_that_cannot_start_again_names_its_samples(farm, tmp_path):
    report = farm(tmp_path / "d", 4, f"crash=1 starts={tmp_path / 'starts'}")
    assert [fault.index for fault in report.faults] == [1, 2, 3]
    assert report.faults[2].reason == "Blender ended with exit status 1: no more"


def test_a_damaged_image_without_a_row_is_rendered_again(farm, tmp_path):
    farm(tmp_path / "d", 2)
    whole = contents(tmp_path / "d")
    (tmp_path / "d" / "samples.jsonl").unlink()
    (tmp_path / "d" / "images" / "000001.exr").write_bytes(b"")
    assert len(farm(tmp_path / "d", 2).logs) == 1
    assert contents(tmp_path / "d") == whole


def test_images_without_a_manifest_are_not_taken_for_ones_own(farm, tmp_path):
    farm(tmp_path / "d", 2)
    (tmp_path / "d" / "manifest.json").unlink()
    (tmp_path / "d" / "samples.jsonl").unlink()
    before = contents(tmp_path / "d")
    with pytest.raises(InputError, match=r"has samples but no manifest\.json"):
        farm(tmp_path / "d", 2, "fur")
    assert contents(tmp_path / "d") == before


def test_a_full_disk_names_the_sample_and_leaves_nothing_half_written(farm, tmp_path, monkeypatch):
    real = shard.write_exr

    def full(path, image):
        if "000001" in str(path):
            raise InputError(path, "cannot be written: No space left on device")
        real(path, image)

    monkeypatch.setattr(shard, "write_exr", full)
    report = farm(tmp_path / "d", 3)
    (fault,) = report.faults
    assert fault.index == 1 and fault.reason.endswith("No space left on device")
    assert sorted(name for name in contents(tmp_path / "d") if name.startswith("images")) == [
        "images/000000.exr",
        "images/000002.exr",
    ]
    monkeypatch.undo()
    assert farm(tmp_path / "d", 3).missing == 1
    assert check_dataset(tmp_path / "d") == []


def test_a_row_that_cannot_be_written_is_its_samples_fault(farm, tmp_path, monkeypatch):
    real = Collector.add

    def full(self, row, log):
        if row["index"] == 1:
            raise OSError(28, "No space left on device")
        real(self, row, log)

    monkeypatch.setattr(Collector, "add", full)
    (fault,) = farm(tmp_path / "d", 3).faults
    assert (fault.index, fault.reason) == (1, "its row cannot be written: No space left on device")
    monkeypatch.undo()
    farm(tmp_path / "d", 3)
    assert check_dataset(tmp_path / "d") == []


def test_a_row_that_does_not_fit_on_the_disk_leaves_no_part_of_it(tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with collecting(tmp_path / "d", {"recipe": "grass"}, 3) as collector:
        collector.add({"index": 0, "file": "images/000000.exr"}, None)
        rows = (tmp_path / "d" / "samples.jsonl").read_text()
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(rows) + 20, hard))  # Python ignores the signal that goes with it
        try:
            with pytest.raises(OSError):
                collector.add({"index": 1, "file": "images/000001.exr"}, None)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert (tmp_path / "d" / "samples.jsonl").read_text() == rows
        assert collector.missing(3) == [1, 2]


def test_killed_midway_the_next_run_redoes_at_most_an_image_a_worker(tmp_path):
    trace, folder, count, workers = tmp_path / "trace", tmp_path / "d", 30, 2
    code = f"""
from pathlib import Path
from mesoshell.datasets.blender.render import Farm, render_dataset
from tests.helpers.stand_ins import STAND_IN, ignore, settings
render_dataset(settings("slow=0.05 trace={trace}"), {count}, Path({str(folder)!r}), Farm({workers}, 1, None, STAND_IN), ignore)
"""
    run = subprocess.Popen([sys.executable, "-c", code], cwd=Path(__file__).parents[3], start_new_session=True)
    rows = folder / "samples.jsonl"
    deadline = time.monotonic() + 60
    while not (rows.exists() and len(rows.read_text().splitlines()) >= 6):
        assert time.monotonic() < deadline and run.poll() is None
        time.sleep(0.01)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    time.sleep(0.5)  # the orphans finish the image in hand
    report = render_dataset(
        settings(f"slow=0.05 trace={trace}"), count, folder, Farm(workers, 1, None, STAND_IN), ignore
    )
    assert 0 < report.missing <= count - 6 and not report.faults
    assert check_dataset(folder) == []
    rendered = [int(line) for line in trace.read_text().split()]
    assert set(rendered) == set(range(count)) and len(rendered) <= count + workers


def test_a_folder_of_another_dataset_is_refused_and_left_as_it_was(farm, tmp_path):
    farm(tmp_path / "d", 2)
    before = contents(tmp_path / "d")
    with pytest.raises(InputError, match=r"manifest\.json: has recipe grass, asked for fur"):
        farm(tmp_path / "d", 2, "fur")
    with pytest.raises(InputError, match=r"manifest\.json: has seed 0, asked for 1"):
        render_dataset(settings(seed=1), 2, tmp_path / "d", Farm(1, 1, None, STAND_IN), ignore)
    assert contents(tmp_path / "d") == before


def test_two_runs_do_not_write_into_one_folder(farm, tmp_path):
    farm(tmp_path / "d", 1)
    manifest = json.loads((tmp_path / "d" / "manifest.json").read_text())
    del manifest["count"]
    with collecting(tmp_path / "d", manifest, 1), pytest.raises(InputError, match="another run is writing into it"):
        farm(tmp_path / "d", 1)


def test_a_process_that_does_not_start_is_one_line(tmp_path):
    broken = Farm(1, 1, None, (sys.executable, "-c", "import nowhere"))
    with pytest.raises(InputError) as caught:
        render_dataset(settings(), 1, tmp_path / "d", broken, ignore)
    assert (
        str(caught.value) == "dataset: Blender ended with exit status 1: ModuleNotFoundError: No module named 'nowhere'"
    )
    assert not (tmp_path / "d").exists()


def test_unusable_settings_write_nothing(farm, tmp_path):
    with pytest.raises(InputError, match="no recipe named unknown; there are: grass"):
        farm(tmp_path / "d", 1, "unknown")
    assert not (tmp_path / "d").exists()


def test_an_interrupt_ends_with_the_images_in_hand(tmp_path):
    class Stop(Exception):
        pass

    def stop(finished, missing, fault):
        if finished == 3:
            raise Stop

    with pytest.raises(Stop):
        render_dataset(settings("slow=0.02"), 20, tmp_path / "d", Farm(2, 1, None, STAND_IN), stop)
    report = render_dataset(settings("slow=0.02"), 20, tmp_path / "d", Farm(2, 1, None, STAND_IN), ignore)
    assert 14 <= report.missing <= 17 and check_dataset(tmp_path / "d") == []
