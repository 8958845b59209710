"""Cases of the command line that need no JAX: options of renders, and whole commands of datasets."""

import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mesoshell.cli.described_scene import scene_of
from mesoshell.cli.main import main
from mesoshell.cli.options.render import Options
from mesoshell.scene.materials import load_material
from mesoshell.scene.setup import describe_shell, describe_surface
from tests.helpers.hostile.trial import Case


def cases(good: Path) -> Iterator[Case]:
    yield from of_options(good)
    yield from of_commands(good)


WILD = (float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e-300, 1e300, 1e38, 1e-45)
OPTIONS: dict[str, list[Any]] = {
    "thickness": list(WILD),
    "scale": list(WILD),
    "irradiance": [x for x in WILD if x not in (0.0, 1e-300, 1e-45)],
    "size": [(0, 1), (-1, 4), (10**5, 10**5), (10**12, 1), (1, 10**18), (10**40, 10**40)],
    "camera": [(x, 0, 3, 0, 0, 0, 40) for x in WILD] + [(0, 0, 3, 0, 0, 0, x) for x in (*WILD, 180.0, 360.0)],
    "light": [((x, x, x),) for x in WILD],
    "base": [(x, 0.1, 0.1) for x in WILD[:3]],
    "seed": [2**32, -(2**40), 10**30],
    "latent": [(2**32, 0.5), (1, -0.1), *((1, x) for x in WILD[:3])],
    "param": [
        (x,) for x in ("age", "age=", "=1", "age=nan", "age=1e999", "age=none.png", "age=a\0b", "x=1", "\n=1", "age=.")
    ],
    "environment": [Path(x) for x in ("none", ".", "a\0b", "n" * 5000, "a\nb", "/dev/zero", "/dev/null", "\udcff.exr")],
    "object": [(Path(x),) for x in ("none.obj", ".", "a\0b.obj", "n" * 5000, "/dev/zero", "a\nb.obj", "\udcff.ply")],
    "mesh": [Path(x) for x in ("none.obj", ".", "a\0b.obj", "n" * 5000, "/dev/zero", "a\nb.obj", "x.abc", "x")],
}

#: The library's arguments where options are named otherwise.
ARGUMENTS = {"param": "params", "light": "lights", "object": "objects", "base": "base_colour"}


def of_options(good: Path) -> Iterator[Case]:
    """What `render` makes of numbers and names, before an engine sees them; for shells and for surface materials."""
    shell, surface = load_material(good / "shell.npz"), load_material(good / "surface.npz")
    plain = Options(good / "quad.obj", size=(8, 8))
    for name, values in OPTIONS.items():
        for value in values:
            options = dataclasses.replace(plain, **{name: value})
            named = (
                f"--{name}: ",
                f"{ARGUMENTS.get(name, name)}: ",
                *(str(x)[:40].encode("unicode_escape").decode() for x in _flat(value)),
                "quad.obj",
            )

            def run(at: Path, options=options) -> Any:
                found = describe_shell(scene_of(options, shell))
                return [vars(found.shell), vars(found.camera), found.lights]

            yield Case("render options", f"--{name} {value!s:.40}", (*named, "scale: ", "thickness: "), run)
            if name in ("scale", "camera", "light", "environment"):
                run = lambda at, options=options: vars(describe_surface(scene_of(options, surface)).camera)  # noqa: E731
                yield Case("surface options", f"--{name} {value!s:.40}", named, run)


def _flat(value: Any) -> list[Any]:
    return list(value) if isinstance(value, tuple) else [value]


def of_commands(good: Path) -> Iterator[Case]:
    """Whole commands of datasets: one line and status 2, and nothing is made."""
    packed = str(good / "packed")
    places = ("/dev/null/x", "/dev/full", "", ".", "n" * 300, "a\0b", "/proc/x", f"{good}/quad.obj/x")
    given = [["dataset", verb, packed, "--out", place] for verb in ("sheet", "pack") for place in places]
    given += [["dataset", "pack", packed, "--out", "p", "--size", n] for n in ("0", "-1", "5", "1e3", "x", "9" * 50)]
    given += [
        ["dataset", "sheet", packed, "--out", "s.png", f"--{k}", n]
        for k in ("count", "columns")
        for n in ("0", "-9", "x", "1.5")
    ]
    given += [["dataset", "sheet", packed, "--out", "s.png", "--sort", k] for k in ("none", "", "a\nb")]
    given += [
        ["dataset", verb, place, "--out", "o"]
        for verb in ("sheet", "pack")
        for place in ("none", "", "a\0b", "/dev/null", "\udcff")
    ]
    given += [["dataset", "render", "grass", "--out", "o", "--count", n] for n in ("0", "-1", "9" * 30, "x", "nan")]
    given += [["dataset", "render", "grass", "--out", "o", "--count", "1", "--size", n] for n in ("0", "9" * 12, "x")]
    given += [
        ["dataset", "render-patches", "weave", "--out", "o", f"--{k}", n]
        for k in ("patches", "queries", "spp")
        for n in ("0", "9" * 20)
    ]
    given += [
        ["atlas", "capture", f"{good}/quad.obj", "--out", "o", f"--{k}", n]
        for k in ("views", "size", "points", "noise")
        for n in ("-1", "nan")
    ]
    given += [
        ["dataset", verb, "grass", "--size", "8", "--out", place] for verb in ("vary", "cost") for place in places
    ]
    given += [
        ["atlas", "capture", f"{good}/quad.obj", "--out", place] for place in ("/dev/null/x", "", "a\0b", "/proc/x")
    ]
    yield from commands(given)


def commands(given: list[list[str]]) -> Iterator[Case]:
    """Commands that must all be refused, each in an empty folder that stays empty."""
    for arguments in given:

        def run(at: Path, arguments=arguments) -> None:
            os.chdir(at)
            try:
                main(arguments)
            finally:
                left = sorted(p.name for p in at.iterdir())
                os.chdir("/")
                assert not left, f"made {left}"
            raise AssertionError("accepted")

        yield Case("commands", " ".join(arguments)[:60].encode("unicode_escape").decode(), ("mesoshell: ",), run)
