"""Generated cases, one after the other in one process of bounded memory.

`python -m tests.helpers.hostile.trial FOLDER KIND` prints a line of JSON a case.

A case is a name, what a refusal must name (one of some texts), and what is done in a folder of its own, which returns numbers.
KIND is which cases: "plain" and "option" import no JAX; "jax" does, once; "engine" renders.
"""

import contextlib
import importlib
import json
import os
import re
import resource
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

#: Bytes of address space; seconds that a case may take.
SPACE, LONGEST = 3 * 2**30, 120


class Case(NamedTuple):
    group: str
    name: str
    #: One of these is in the line that refuses it.
    named: tuple[str, ...]
    run: Callable[[Path], Any]


class Late(Exception):
    """A case took too long."""


def tried(case: Case, folder: Path) -> dict[str, Any]:
    """What became of it: "refused", "accepted" or "fell"; what it said, printed, and left."""
    from mesoshell.cli.ending import in_one_line
    from mesoshell.errors import InputError

    begin = time.monotonic()
    folder.mkdir()
    printed = folder.parent / "printed"
    before = [os.dup(1), os.dup(2)]
    with printed.open("w+b") as file:
        for k in (1, 2):
            os.dup2(file.fileno(), k)
        signal.alarm(LONGEST)
        try:
            with in_one_line():
                found, said = _outcome(case, folder, InputError)
        finally:
            signal.alarm(0)
            sys.stdout.flush()
            sys.stderr.flush()
            for k, kept in zip((1, 2), before, strict=True):
                os.dup2(kept, k)
                os.close(kept)
    left = [str(p.relative_to(folder)) for p in folder.rglob("*.partial")]
    # of this program: getrusage counts what its parent held when it was made
    held = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    peak = int(held[1]) / 1024 if held else 0.0
    shutil.rmtree(folder)
    spent = time.monotonic() - begin
    return {
        **case._asdict(),
        "run": None,
        "found": found,
        "said": said,
        "printed": printed.read_text(),
        "left": left,
    } | {"peak": peak, "seconds": spent}


def _outcome(case: Case, folder: Path, refusal: type[Exception]) -> tuple[str, str]:
    try:
        numbers = case.run(folder)
    except refusal as fault:
        return "refused", str(fault)
    except SystemExit as end:
        return ("refused" if end.code == 2 else "accepted" if end.code in (0, 1, None) else "fell"), f"exit {end.code}"
    except BaseException:
        return "fell", traceback.format_exc(limit=-3)
    wild = [a for a in _arrays(numbers) if a.dtype.kind == "f" and not np.isfinite(a).all()]
    return ("fell", f"{len(wild)} arrays are not finite") if wild else ("accepted", "")


def _arrays(found: Any) -> Iterable[np.ndarray]:
    if isinstance(found, np.ndarray):
        yield found
    elif isinstance(found, dict):
        yield from (a for x in found.values() for a in _arrays(x))
    elif isinstance(found, list | tuple):
        yield from (a for x in found for a in _arrays(x))


def _late(*_: object) -> None:
    raise Late


def run(where: Path, kind: str) -> None:
    """All cases of a kind."""
    from tests.helpers.hostile import samples

    (where / "good").mkdir()
    samples.make(where / "good")
    cases = importlib.import_module(f"tests.helpers.hostile.{kind}_cases").cases
    resource.setrlimit(resource.RLIMIT_AS, (SPACE if kind in ("plain", "option") else 2**35, resource.RLIM_INFINITY))
    signal.signal(signal.SIGALRM, _late)
    for number, case in enumerate(cases(where / "good")):
        print(json.dumps(tried(case, where / f"{number}")), flush=True)
    if kind in ("plain", "option"):
        assert "jax" not in sys.modules


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError):
        run(Path(sys.argv[1]), sys.argv[2])
