"""Commands end in one line and a status, whatever they were given and wherever they write."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mesoshell.cli.main import main
from mesoshell.errors import InputError

USAGE = [
    ["render"],
    ["rendr"],
    ["render", "a.obj", "--foo"],
    ["render", "a.obj", "--size", "x", "1"],
    ["render", "a.obj", "--size", "1"],
    ["render", "a.obj", "--engine", "none"],
    ["render", "a.obj", "--irradiance", "much"],
    ["dataset"],
    ["dataset", "pack"],
    ["train", "x.py"],
    ["train", "x.py", "--preset", "huge"],
    ["atlas", "render"],
    ["atlas", "mesh", "--quads", "1.5"],
    ["texture", "--extent", "1"],
    ["--bogus"],
]


@pytest.mark.parametrize("arguments", USAGE, ids=" ".join)
def test_a_fault_of_usage_is_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    said = capsys.readouterr().err
    assert end.value.code == 2
    assert said.startswith("mesoshell: ") and said.count("\n") == 1 and "--help" in said and "│" not in said


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--size", "256"], "--size takes INT INT, not 256 (see mesoshell render --help)"),
        (["--budget", "much"], "--budget takes FLOAT, not much (see mesoshell render --help)"),
        (["--foo"], "Unrecognized options: --foo (see mesoshell render --help)"),
    ],
)
def test_a_wrong_value_is_told_what_it_should_be(arguments: list[str], line: str, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        main(["render", "a.obj", *arguments])
    assert capsys.readouterr().err == f"mesoshell: {line}\n"


def test_a_newline_in_a_name_is_escaped(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as end:
        main(["render", "a\nb\x1b[31m\udcff.obj"])
    said = capsys.readouterr().err
    assert end.value.code == 2 and said == "mesoshell: a\\nb\\x1b[31m\\udcff.obj: no such file\n"


def test_a_fault_is_never_long():
    said = str(InputError("a", "x" * 10**6))
    assert said.startswith("a: x") and len(said) < 1100


def _started(code: str, **how) -> subprocess.Popen:
    program = """
from mesoshell.cli.commands import doctor
from mesoshell.cli.main import main
doctor.run = lambda options: run()
main(["doctor"])
"""
    buffered = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    command = [sys.executable, "-c", f"{code}\n{program}"]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=buffered, **how)


PRINTS = "def run() -> None:\n    print('x' * {})\n"


@pytest.mark.parametrize(
    ("length", "end"),
    [
        (100_000, ""),
        (1, "    raise SystemExit(1)\n"),
        pytest.param(1, "", marks=pytest.mark.slow),
        pytest.param(100_000, "    raise SystemExit(1)\n", marks=pytest.mark.slow),
    ],
)
def test_a_full_disk_behind_standard_output_is_one_line(length: int, end: str):
    """What is printed fails when it is written out at the end; or at once, and then nothing says what was not written."""
    with Path("/dev/full").open("w") as full:
        found = _started(PRINTS.format(length) + end, stdout=full)
        said = found.communicate()[1]
    assert found.returncode == 2
    where = "standard output: cannot be written: " if length == 1 else ""
    assert said == f"mesoshell: {where}No space left on device\n"


WARNS = """
import warnings
import numpy as np
def run() -> None:
    np.float32(1e38) * np.float32(10)
    warnings.warn('a\\nb')
"""


def test_a_warning_is_one_line_and_arithmetic_has_none():
    assert _started(WARNS, stdout=subprocess.DEVNULL).communicate()[1] == "mesoshell: warning: a\\nb\n"


def test_a_reader_that_leaves_is_no_fault():
    read, write = os.pipe()
    os.close(read)
    found = _started(PRINTS.format(100_000), stdout=write)
    os.close(write)
    assert found.communicate()[1] == "" and found.returncode == 141


SWALLOWS = """
import sys, time
def run() -> None:
    print('ready', flush=True)
    try:
        time.sleep(20)
    except BaseException:
        pass
    time.sleep(20)
"""


COLLECTED = """
import gc, sys, time
def hear(phase, info):
    print('ready', flush=True)
    time.sleep(20)
def run() -> None:
    gc.callbacks.append(hear)
    gc.collect()
    gc.callbacks.clear()
    time.sleep(20)
"""


@pytest.mark.parametrize(
    "code",
    [SWALLOWS, SWALLOWS.replace("BaseException", "ValueError"), COLLECTED],
    ids=["swallowed", "heard", "collected"],
)
def test_an_interrupt_is_one_line_even_if_it_is_swallowed(code: str):
    found = _started(code, stdout=subprocess.PIPE)
    assert found.stdout is not None and found.stdout.readline() == "ready\n"
    begin = time.monotonic()
    found.send_signal(signal.SIGINT)
    assert found.communicate()[1] == "mesoshell: interrupted\n" and found.returncode == 130
    assert time.monotonic() - begin < 15  # of the 40 s that it would sleep


IMPORTED = """
import importlib.abc, signal, sys
class Slow(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "tyro":
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Slow())
sys.argv = ["mesoshell", "doctor"]
from mesoshell.__main__ import main
main()
"""


def test_an_interrupt_while_the_command_line_is_imported_is_one_line():
    found = subprocess.run([sys.executable, "-c", IMPORTED], capture_output=True, text=True)
    assert (found.stderr, found.returncode) == ("mesoshell: interrupted\n", 130)


FAULTS = {
    "OSError": ("OSError(28, 'No space left on device', 'a\\nb')", "mesoshell: a\\nb: No space left on device\n"),
    "memory": ("MemoryError('298 GiB')", "mesoshell: out of memory: 298 GiB\n"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_the_system_refuses_is_one_line(name: str, monkeypatch, capsys: pytest.CaptureFixture[str]):
    def run(options: object) -> None:
        raise eval(FAULTS[name][0])

    monkeypatch.setattr("mesoshell.cli.commands.doctor.run", run)
    with pytest.raises(SystemExit) as end:
        main(["doctor"])
    assert end.value.code == 2 and capsys.readouterr().err == FAULTS[name][1]
