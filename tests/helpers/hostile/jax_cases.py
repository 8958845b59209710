"""Cases of what imports JAX, once for all of them: experiments, run folders, captured objects, queries that are fed."""

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import numpy as np

from mesoshell.io.query_dataset import read_patches
from mesoshell.io.records import read_rows
from mesoshell.nets.encoding import HashConfig
from mesoshell.neutex.cameras import Photo
from mesoshell.neutex.field import FieldConfig, init_field
from mesoshell.neutex.store import NeuTexModel, read_neutex, write_neutex
from mesoshell.train.experiment import experiment_of
from mesoshell.train.gan.presets import PRESETS
from mesoshell.train.report import write_report
from mesoshell.train.run_config import read_record, snapshots
from mesoshell.train.surface.step import feed, surface_config
from tests.helpers.hostile import samples
from tests.helpers.hostile.damage import THINGS, damaged, variants
from tests.helpers.hostile.option_cases import commands
from tests.helpers.hostile.plain_cases import _put
from tests.helpers.hostile.trial import Case

EXPERIMENTS = [
    "",
    "config = None",
    "config = 3",
    "config = object()",
    "import sys; sys.exit()",
    "import sys; sys.exit(3)",
]
EXPERIMENTS += [
    "raise SystemExit",
    "raise KeyError('a\\nb')",
    "raise MemoryError",
    "assert False",
    "import nothing_such",
    "1/0",
]
EXPERIMENTS += [
    "def variant(preset): return 1",
    "def f(: pass",
    "\tx = 1\n  y = 2",
    "config = 'x' * 10**6",
    "x = '\\udcff'.encode()",
]
EXPERIMENTS += [
    "def f(): f()\nf()",
    "from mesoshell.train.gan.state import GanConfig\nconfig = GanConfig",
    "\0",
    "é = 1\nconfig = é",
]
EXPERIMENTS += [
    "from mesoshell.train.gan.state import GanConfig\nconfig = GanConfig(batch='x', nothing=1)",
    "raise Exception('x' * 10**6)",
]


def cases(good: Path) -> Iterator[Case]:
    yield from of_experiments()
    yield from of_runs()
    yield from of_rows()
    yield from of_objects(good)
    yield from of_fed(good)
    yield from of_commands(good)


def of_experiments() -> Iterator[Case]:
    for i, text in enumerate(EXPERIMENTS):
        for preset in (None, "tiny"):

            def run(at: Path, text=text, preset=preset) -> None:
                (at / "x.py").write_text(text, errors="surrogateescape")
                experiment_of(at / "x.py", preset)
                raise AssertionError("accepted")

            yield Case("experiments", f"{i} {preset}", ("x.py",), run)
    for thing, put in THINGS.items():
        yield Case("experiments", thing, ("x.py",), lambda at, put=put: (put(at / "x.py"), experiment_of(at / "x.py")))


def of_runs() -> Iterator[Case]:
    """config.json of a run of each way to learn."""
    record = json.loads(json.dumps({"config": asdict(PRESETS["tiny"]), "data": {"folder": "d", "recipe": "grass"}}))
    surface = {"method": "surface", "config": asdict(surface_config(PRESETS["tiny"], (8,))), "data": {"folder": "d"}}
    for name, said in (("gan", record), ("surface", json.loads(json.dumps(surface)))):
        for what, other in variants(said, 40):
            yield Case(
                "config.json",
                f"{name} {what}",
                ("config.json",),
                _written("config.json", json.dumps(other), read_record),
            )
        for seed in range(9):
            data = damaged(json.dumps(said).encode(), seed)
            yield Case(
                "config.json", f"{name} damaged {seed}", ("config.json",), _written("config.json", data, read_record)
            )
    for thing, put in THINGS.items():
        yield Case(
            "config.json", thing, ("config.json",), lambda at, put=put: (put(at / "config.json"), read_record(at))
        )
        yield Case("snapshots", thing, ("snapshots",), lambda at, put=put: (put(at / "snapshots"), snapshots(at)))


def of_rows() -> Iterator[Case]:
    row = {"name": "KID", "kimg": 1.0, "images": 20, "value": 0.5, "low": 0.4, "high": 0.6}
    log = {
        "kimg": 1.0,
        "images_per_s": 3.0,
        "generator": 1.0,
        "discriminator": 1.0,
        "r1": 1.0,
        "real": 0.1,
        "fake": 0.1,
    }
    for file, fields in (("evaluation.jsonl", row), ("log.jsonl", log)):
        text = (json.dumps(fields) + "\n").encode() * 3
        for seed in range(18):
            yield Case(file, f"damaged {seed}", (file,), _written(file, damaged(text, seed), write_report))
        for what, other in variants(fields, 30):
            lines = (json.dumps(fields) + "\n" + json.dumps(other) + "\n").encode(errors="surrogatepass")
            yield Case(file, what, (file,), _written(file, lines, write_report))
        for thing, put in THINGS.items():
            yield Case(file, thing, (file,), lambda at, file=file, put=put: (put(at / file), len(read_rows(at / file))))


def _written(file: str, data: bytes | str, read: Callable[[Path], Any]) -> Callable[[Path], Any]:
    def run(at: Path) -> None:
        (at / file).write_bytes(data if isinstance(data, bytes) else data.encode(errors="surrogatepass"))
        read(at)

    return run


def of_objects(good: Path) -> Iterator[Case]:
    hashed = HashConfig(levels=2, rows=4, coarsest=2, finest=4)
    config = FieldConfig(hash=hashed)
    photo = Photo(np.eye(4), (9.0, 9.0, 3.0, 3.0), 6, 6)
    field = init_field(config, jax.random.key(0))
    write_neutex(good / "object.npz", NeuTexModel(config, field, np.zeros(3), 1.0, (photo, photo), (0,), {}))
    data = (good / "object.npz").read_bytes()
    for seed in range(18):
        cut = damaged(data, seed)
        yield Case("object.npz", f"damaged {seed}", ("o.npz",), lambda at, cut=cut: _object(at / "o.npz", cut))
    with np.load(good / "object.npz") as file:
        arrays = {key: file[key] for key in file.files if key != "manifest.json"}
        said = json.loads(file["manifest.json"].tobytes())
    for what, other in variants(said, 60):

        def run(at: Path, other=other) -> None:
            samples.shell(at / "o.npz", other, arrays)
            read_neutex(at / "o.npz")

        yield Case("object.npz", what, ("o.npz",), run)
    for thing, put in THINGS.items():
        yield Case("object.npz", thing, ("o.npz",), lambda at, put=put: (put(at / "o.npz"), read_neutex(at / "o.npz")))


def _object(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    read_neutex(path)


def of_fed(good: Path) -> Iterator[Case]:
    """Queries with NaN, or infinite."""
    config = surface_config(PRESETS["tiny"], (8,))
    for value in (np.nan, np.inf):

        def put(path: Path, value=value) -> None:
            np.save(path, np.full((2000, 16), value, np.float32))

        def read(folder: Path) -> Any:
            found = read_patches(folder)
            batch = feed(config, type(found)(found.folder, found.manifest, found.patches * 2))(0)
            return [np.asarray(x) for x in batch]

        yield Case("fed queries", f"{value}", ("/d",), _put(good / "queries", "patches/000000.npy", put, read))


def of_commands(good: Path) -> Iterator[Case]:
    """Commands that write at places where nothing can be, or ask for more than there is: refused before their work."""
    packed, shell, thing = (str(good / name) for name in ("packed", "shell.npz", "object.npz"))
    given = [
        ["fit", packed, "--out", "/dev/null/x.npz"],
        ["fit", packed, "--run", f"{shell}/x"],
        ["fit", "none"],
        ["fit"],
    ]
    fit = ["fit", packed, "--run", "r", "--out", "o.npz"]
    given += [[*fit, f"--{name}", n] for name in ("rays", "texels", "width") for n in ("0", "-1", "9" * 20, "x")]
    given += [[*fit, "--seed", n] for n in ("9" * 30, "-" + "9" * 30, "1.5")]
    for place in ("/dev/null/x", "/proc/x", f"{shell}/x"):
        given += [
            ["export", "none", "--out", place],
            ["prefilter", "none", "--out", place],
            ["texture", shell, "--out", place],
            ["atlas", "render", thing, "--out", place],
        ]
        given += [["texture", shell, "--out", f"{place}.npz"], ["distill", "weave", "--out", f"{place}.npz"]]
        given += [
            ["atlas", "texture", thing, "--out", f"{place}.png"],
            ["atlas", "mesh", thing, "--out", f"{place}.glb"],
        ]
    for size in ("0", "-1", "9" * 9, "x"):
        given += [
            ["atlas", "texture", thing, "--out", "o.png", "--size", size],
            ["atlas", "mesh", thing, "--out", "o.glb", "--size", size],
        ]
        given += [
            ["atlas", "mesh", thing, "--out", "o.glb", "--quads", size],
            ["atlas", "render", thing, "--out", "o", "--size", size, size],
        ]
        given += [["distill", "weave", "--out", "o.npz", f"--{name}", size] for name in ("patches", "queries", "spp")]
    given += [["atlas", "render", thing, "--out", "o", "--frames", n] for n in ("0", "9" * 18)]
    given += [["atlas", "render", thing, "--out", "o", "--samples", n] for n in ("0", "-5")]
    given += [
        ["evaluate", "none"],
        ["evaluate", packed],
        ["evaluate", packed, "--images", "0"],
        ["evaluate", packed, "--snapshots", "0"],
    ]
    given += [
        ["distill", "none", "--out", "o.npz"],
        ["distill", shell, "--out", "o.png"],
        ["distill", shell, "--twin", "o.npz", "--base", "2", "0", "0"],
    ]
    for case in commands(given):
        yield case._replace(group="jax commands")
