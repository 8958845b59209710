"""Some 1600 generated cases (plain_cases, option_cases, jax_cases, engine_cases), by seeds: each is refused in one line that
names the file or the option, or taken, with numbers that are finite; memory is bounded, and nothing is printed or left beside.

Each kind runs in one process (trial), whose memory and time a case are limited."""

import json
import os
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
#: MiB that the process may have held at most: it holds JAX, or an engine, too.
PEAK = {"plain": 600, "option": 600, "jax": 1500, "engine": 6000}
#: Groups of cases, and how many there are of each at least.
PLAIN = {
    "quad.obj": 28,
    "ball.glb": 28,
    "ball.gltf": 28,
    "ball.off": 28,
    "ball.stl": 28,
    "ball.ply": 28,
    "text.ply": 28,
    "ball.dae": 28,
    "ball.zae": 28,
    "ball.3mf": 28,
    "ball.zip": 28,
    "ball.usda": 28,
    "ball.usdc": 28,
    "ball.usdz": 28,
    "shell.npz": 28,
    "surface.npz": 28,
}
PLAIN |= {"sky.exr": 28, "float.exr": 28, "a.png": 28, "a.jpg": 28, "weights": 9, "cameras.npz": 18, "COLMAP": 39}
PLAIN |= {"shell.npz manifest": 30, "surface.npz manifest": 30, "shell.npz arrays": 20, "surface.npz arrays": 20}
PLAIN |= {"dataset plain": 100, "dataset packed": 100, "queries": 80, "transforms": 75}
OPTION = {"commands": 60, "render options": 90, "surface options": 40}
JAX = {
    "experiments": 50,
    "config.json": 100,
    "snapshots": 10,
    "evaluation.jsonl": 50,
    "log.jsonl": 50,
    "object.npz": 80,
}
JAX |= {"fed queries": 2, "jax commands": 75}
ENGINE = {"jax": 90, "mitsuba": 90, "XML": 60}


def tried(kind: str, folder: Path) -> dict[str, list[dict[str, Any]]]:
    """What became of all cases of a kind, by group."""
    command = [sys.executable, "-m", "tests.helpers.hostile.trial", str(folder), kind]
    # a cache would be written for each of a thousand small programs
    alone = os.environ | {"XDG_CACHE_HOME": str(folder / "cache"), "JAX_ENABLE_COMPILATION_CACHE": "false"}
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=alone)
    assert found.returncode == 0 and found.stderr == "", found.stderr[-2000:]
    groups = defaultdict(list)
    for line in found.stdout.splitlines():
        groups[json.loads(line)["group"]].append(json.loads(line))
    return groups


def check(cases: list[dict[str, Any]], least: int, peak: float) -> None:
    """The promise, of all of a group at once: every case that breaks it is shown."""
    assert len(cases) >= least
    broken = [f"{case['name']}: {fault}" for case in cases if (fault := _fault(case, peak))]
    assert not broken, "\n".join(broken)


def _fault(case: dict[str, Any], peak: float) -> str:
    command = case["said"].startswith("exit")  # which prints what a reader raises
    # one line that begins so, after notes
    said = [x for x in case["printed"].splitlines() if x.startswith("mesoshell: ")] if command else [case["said"]]
    if case["found"] == "fell":
        return case["said"]
    if case["found"] == "refused" and not (len(said) == 1 and "\n" not in said[0] and len(said[0]) < 1300):
        return f"is refused in {len(said)} lines: {case['said']} {case['printed']}"
    if case["found"] == "refused" and not any(name in said[0] for name in case["named"]):
        return f"names none of {case['named']}: {said[0]}"
    if "Traceback" in case["printed"] or (case["printed"] and not command and case["group"] not in ENGINE):
        return f"prints {case['printed']}"
    return f"leaves {case['left']}" if case["left"] else f"held {case['peak']} MiB" if case["peak"] > peak else ""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, list[dict[str, Any]]]]:
    return {kind: tried(kind, tmp_path_factory.mktemp(kind)) for kind in ("plain", "option", "jax")}


@pytest.mark.xdist_group("generated cases")
@pytest.mark.parametrize("group", PLAIN)
def test_without_jax(found, group: str):
    check(found["plain"][group], PLAIN[group], PEAK["plain"])


@pytest.mark.xdist_group("generated cases")
@pytest.mark.parametrize("group", OPTION)
def test_options(found, group: str):
    check(found["option"][group], OPTION[group], PEAK["option"])


@pytest.mark.xdist_group("generated cases")
@pytest.mark.parametrize("group", JAX)
def test_with_jax(found, group: str):
    check(found["jax"][group], JAX[group], PEAK["jax"])


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[dict[str, Any]]]:
    return tried("engine", tmp_path_factory.mktemp("engine"))


@pytest.mark.slow
@pytest.mark.xdist_group("generated pictures")
@pytest.mark.parametrize("group", ENGINE)
def test_pictures(rendered, group: str):
    check(rendered[group], ENGINE[group], PEAK["engine"])
