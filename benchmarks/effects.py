"""What each effect costs and what is lost without it: python -m benchmarks.effects [--side 64] [--out PAGE]

Each is tried in a scene that calls for it: the picture as planned and the same with that effect alone switched off, in turn, in
one run. Writes the table between the page's marks, and the pairs of pictures beside the page's other pictures.
"""

import argparse
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mesoshell as ms
from benchmarks.paths import SCENES, shot, slab
from mesoshell.geometry.mesh import Mesh, check_mesh
from mesoshell.io.image import write_png
from mesoshell.measure.flip import flip
from mesoshell.pathtracer import load_dict, load_file
from mesoshell.render.effects import Effect, plan_effects
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.scene.render_shell import facts, marched_scene
from mesoshell.scene.setup import describe_shell
from mesoshell.shell.render.renderer import render

MARKS = "<!-- costs -->", "<!-- end of costs -->"
NORMAL = PRESETS["normal"]
OFF = Effect(False, "for the benchmark")
#: Pictures with and without, in turn; the first of each compiles.
TURNS = 4
#: Paths a pixel of a picture in Mitsuba.
SPP = 8


class Tried(NamedTuple):
    """effects: one, or those that are one program; scene: in words; seconds, queries: with and without; lost: FLIP; noise: FLIP
    of two halves of the pictures, with and without; pair: both pictures."""

    effects: str
    scene: str
    engine: str
    seconds: tuple[float, float]
    queries: tuple[float, float]
    lost: float
    noise: tuple[float, float]
    pair: tuple[np.ndarray, np.ndarray]


#: (number of the picture) -> RGB and queries.
Way = Callable[[int], tuple[np.ndarray, int]]


def tried(effects: str, scene: str, engine: str, ways: tuple[Way, Way]) -> Tried:
    took, shown, asked = ([], []), ([], []), [0, 0]
    for turn in range(TURNS + 1):
        for k, way in enumerate(ways):
            begin = time.perf_counter()
            picture, asked[k] = way(turn)
            took[k].append(time.perf_counter() - begin)
            shown[k].append(np.clip(picture, 0, 1))
    pair = np.mean(shown[0], axis=0), np.mean(shown[1], axis=0)
    noise = [flip(np.mean(x[1::2], axis=0), np.mean(x[2::2], axis=0)) for x in shown]
    seconds = [float(np.median(x[1:])) for x in took]
    return Tried(
        effects, scene, engine, (seconds[0], seconds[1]), (asked[0], asked[1]), flip(*pair), (noise[0], noise[1]), pair
    )


def marched(names: str, words: str, scene: ms.Scene, quality: Quality = NORMAL) -> Tried:
    """In JAX."""
    made = marched_scene(describe_shell(scene))
    plan = plan_effects(facts(made), quality)
    without = replace(plan, **dict.fromkeys(names.split(), OFF))
    assert any(getattr(plan, name).on for name in names.split()), names

    def way(effects: Any) -> Way:
        def one(_: int) -> tuple[np.ndarray, int]:
            image, report = render(made, quality, effects)
            return image[..., :3] + (1 - image[..., 3:]) * 0.2, report.counts["density_queries"]

        return one

    return tried(names, words, "JAX", (way(plan), way(without)))


def traced(names: str, words: str, scene: Any, spp: int = SPP) -> Tried:
    """In Mitsuba; an effect that is planned off is switched on."""
    context = scene.integrator().context
    plan = context.effects
    other = {name: Effect(not getattr(plan, name).on, "for the benchmark") for name in names.split()}
    ways = (plan, replace(plan, **other))
    ways = ways if getattr(plan, names.split()[0]).on else ways[::-1]

    def way(effects: Any) -> Way:
        def one(turn: int) -> tuple[np.ndarray, int]:
            context.effects, before = effects, context.queries
            return shot(scene, spp, turn), context.queries - before

        return one

    made = tried(names, words, "Mitsuba", (way(ways[0]), way(ways[1])))
    context.effects = plan
    return made


def floor() -> Mesh:
    """A square under the cow."""
    points = np.array([[-3.0, -0.74, -3], [3, -0.74, -3], [3, -0.74, 3], [-3, -0.74, 3]])
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    return check_mesh(points, faces, points[faces][..., [0, 2]], "floor")


def plain() -> Mesh:
    points = np.array([[-10.0, 0, -10], [10, 0, -10], [10, 0, 10], [-10, 0, 10]])
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    return check_mesh(points, faces, points[faces][..., [0, 2]], "plain")


def cases(side: int) -> Iterator[Tried]:
    spot = Path(str(Path(ms.__file__).parent / "assets" / "spot.obj"))
    grass, size = ms.load_material("grass"), (side, side)
    sun = [(0.8, 0.5, -0.3)]
    cow = ms.Scene(spot, grass, thickness=0.06, scale=0.12, size=size, lights=sun)
    yield marched("mesh_shadow object_shadow", "a cow, one low sun", cow)
    yield marched("mesh_shadow object_shadow", "a cow on a floor", replace(cow, objects=[floor()]))
    far = replace(cow, camera=(0.0, 6.0, -16.0, 0.0, 0.0, 0.0, 9.0))
    yield marched("filtering", "a cow from afar", far)
    low = replace(cow, mesh=plain(), scale=0.5, thickness=0.1, camera=(0.0, 1.0, -9.0, 0.0, 0.0, 0.0, 40.0))
    yield marched("anisotropic_filtering", "a plain to its horizon, 16 taps", low, NORMAL.with_changes(anisotropy=16))
    age = np.tile(np.linspace(0, 1, 64, dtype=np.float32), (64, 1))
    yield marched("varying_parameters", "a cow, age from left to right", replace(cow, params={"age": age}))
    sky = np.tile(np.linspace(1.0, 0.2, 16)[:, None, None], (1, 32, 3)) * np.array([0.6, 0.8, 1.0])
    yield marched("environment", "a cow under sky and sun", replace(cow, environment=sky))
    yield marched("background", "the same", replace(cow, environment=sky))
    room, yard = (load_file(SCENES / f"{name}.xml", width=side, height=side) for name in ("room", "spot"))
    yield traced("bounces", "a carpet in a room", room)
    yield traced("roulette", "the same", room)
    yield traced("mesh_shadow object_shadow", "a cow on a floor", yard)
    yield traced("shell_shadow", "the same", yard)
    yield traced("camera_in_shell", "the same, though its camera is outside", yard)
    lawn = load_dict(slab({"type": "directional", "direction": [-0.3, -1.0, 0.2]}, side))
    yield traced("quadrature", "a lawn under a sun", lawn)


def row(x: Tried) -> str:
    name = x.effects.replace("_", " ").replace("shadow object", "and object")
    cost = x.seconds[0] / x.seconds[1]
    queries = f"{x.queries[0] / x.queries[1]:.2f}" if x.queries[1] else "–"
    noise = f" (noise {x.noise[0]:.3f}, {x.noise[1]:.3f})" if max(x.noise) > 5e-4 else ""
    return f"| {name} | {x.engine} | {x.scene} | {cost:.2f} | {queries} | {x.lost:.3f}{noise} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--side", type=int, default=64, help="pixels along a side of the pictures")
    parser.add_argument("--out", type=Path, help="page whose table is replaced")
    asked = parser.parse_args()
    found, rows = [], ["| effect | engine | scene | seconds, on/off | queries, on/off | lost without, FLIP |"]
    rows += ["|---|---|---|---|---|---|"]
    for one in cases(asked.side):
        found.append(one)
        rows.append(row(one))
        print(rows[-1], flush=True)
    if asked.out is None:
        return
    text = asked.out.read_text()
    first, last = (re.escape(mark) for mark in MARKS)
    made = "\n".join([MARKS[0], *rows, MARKS[1]])
    asked.out.write_text(re.sub(f"{first}.*{last}", lambda _: made, text, flags=re.DOTALL))
    gap = np.ones((4, asked.side, 3), np.float32)
    strips = [np.concatenate([one.pair[0], gap, one.pair[1]]).astype(np.float32) for one in found]
    write_png(asked.out.parents[1] / "images/effects.png", np.concatenate(strips, axis=1))


if __name__ == "__main__":
    main()
