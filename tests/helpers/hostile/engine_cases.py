"""Cases that end in a picture where they are not refused: `render` by both engines, of damaged files and of very small and
large numbers, and scenes of Mitsuba's."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mesoshell.cli.main import main
from mesoshell.io.image import read_exr
from tests.helpers.hostile.damage import damaged
from tests.helpers.hostile.trial import Case

ENDS = ("1e-300", "1e-30", "1e-6", "1e6", "1e12", "1e30", "1e38", "1e300")
NUMBERS = [[f"--{name}", x] for name in ("thickness", "scale", "irradiance") for x in ENDS]
NUMBERS += [["--light", x, x, "0"] for x in ENDS] + [["--camera", x, "0", "3", "0", "0", "0", "40"] for x in ENDS]
NUMBERS += [["--camera", "0", "0", "3", "0", "0", "0", x] for x in ("1e-300", "1e-6", "179.999999")]
NUMBERS += [["--base", x, x, x] for x in ENDS] + [
    ["--camera", "0", "9", "0", "0", "0", "0", "40"],
    ["--size", "1", "1"],
]

SCENE = """<scene version="3.0.0">
  <integrator type="mesoshell_path"><integer name="max_depth" value="3"/></integrator>
  <sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="2, 2, 2" target="0, 0, 0" up="0, 0, 1"/></transform>
    <sampler type="independent"><integer name="sample_count" value="1"/></sampler>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
  <emitter type="constant"/>
  <shape type="obj"><string name="filename" value="{mesh}"/>
    <bsdf type="mesoshell"><string name="material" value="{material}"/></bsdf></shape>
</scene>
"""
SWAPS = [('"40"', x) for x in ('"nan"', '"-1"', '"1e300"', '"x"', '""')]
SWAPS += [
    ('name="max_depth" value="3"', f'name="max_depth" value="{x}"') for x in ("0", "-7", "99999999999", "1.5", "x")
]
SWAPS += [('name="width" value="8"', f'name="width" value="{x}"') for x in ("0", "-1", "99999999", "nan")]
SWAPS += [('"sample_count" value="1"', f'"sample_count" value="{x}"') for x in ("0", "-1", "99999999999", "x")]
SWAPS += [("{mesh}", x) for x in ("none.obj", "", ".", "/dev/zero")] + [
    ("{material}", x) for x in ("none", "", ".", "/dev/zero")
]
SWAPS += [
    ('"0, 0, 0"', '"2, 2, 2"'),
    ('"0, 0, 0"', '"nan, 0, 0"'),
    ('type="constant"', 'type="none"'),
    ('"mesoshell"', '"none"'),
]
SWAPS += [('<string name="material"', '<string name="other" value="1"/><string name="material"')]
SWAPS += [
    ('<string name="material"', f'<float name="{k}" value="{x}"/><string name="material"')
    for k in ("thickness", "scale")
    for x in ("0", "nan", "-1", "1e300")
]


def cases(good: Path) -> Iterator[Case]:
    for engine in ("jax", "mitsuba"):
        for given in NUMBERS:
            yield Case(engine, " ".join(given), ("--", "quad.obj"), _picture(good, engine, given))
        for file, option in (
            ("quad.obj", None),
            ("ball.glb", None),
            ("sky.exr", "--environment"),
            ("a.png", "--param"),
            ("shell.npz", "--material"),
        ):
            for seed in range(9):
                yield Case(engine, f"{file} {seed}", (file,), _damaged(good, engine, file, option, seed))
    said = SCENE.replace("{mesh}", str(good / "quad.obj")).replace("{material}", str(good / "shell.npz"))
    for seed in range(36):
        yield Case("XML", f"damaged {seed}", ("a.xml",), _scene(damaged(said.encode(), seed)))
    for old, new in SWAPS:
        text = (
            SCENE.replace(old, new)
            .replace("{mesh}", str(good / "quad.obj"))
            .replace("{material}", str(good / "shell.npz"))
        )
        yield Case("XML", f"{new}", ("a.xml", "none", "--", "material", "/dev/zero", "."), _scene(text.encode()))


def _picture(good: Path, engine: str, given: list[str]) -> Callable[[Path], Any]:
    def run(at: Path) -> Any:
        mesh = [] if given[:1] == ["--mesh"] else [str(good / "quad.obj")]
        few = ["--spp", "1", "--max-depth", "3"] if engine == "mitsuba" else []
        material = [] if "--material" in given else ["--material", str(good / "shell.npz")]
        size = [] if "--size" in given else ["--size", "8", "8"]
        rest = given[1:] if mesh == [] else given
        main(
            [
                "render",
                *mesh,
                *rest,
                *material,
                *size,
                *few,
                "--quality",
                "draft",
                "--engine",
                engine,
                "--out",
                str(at / "o.png"),
            ]
        )
        return _whole(at)

    return run


def _damaged(good: Path, engine: str, file: str, option: str | None, seed: int) -> Callable[[Path], Any]:
    def run(at: Path) -> Any:
        (at / file).write_bytes(damaged((good / file).read_bytes(), seed))
        path = str(at / file)
        given = ["--mesh", path] if option is None else [option, f"age={path}" if option == "--param" else path]
        return _picture(good, engine, given)(at)

    return run


def _scene(data: bytes) -> Callable[[Path], Any]:
    def run(at: Path) -> Any:
        (at / "a.xml").write_bytes(data)
        main(["render", str(at / "a.xml"), "--engine", "mitsuba", "--out", str(at / "o.png")])
        return _whole(at)

    return run


def _whole(at: Path) -> np.ndarray:
    """The radiance of a picture whose three files are there."""
    assert json.loads((at / "o.json").read_text())["seconds"] and (at / "o.png").stat().st_size
    return read_exr(at / "o.exr")
