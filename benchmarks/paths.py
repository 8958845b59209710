"""What path tracing costs: python -m benchmarks.paths [--side 192] [WAY]

Prints, in one run: samples of a material decoded a second, over what this machine's matrix products would allow; first and
second picture; paths a second against Mitsuba's own `path` on the bare meshes; and seconds to 5% error on three scenes.
--later: instead, what wider footprints after an event change and save (`Quality.bounce_spread`). --gates: instead, how much
longer pictures take with all effects compiled than with those that their scenes call for, in turn. --spacing: instead, what
samples by density cost and err beside those by length (`Quality.spacing`), and beside the settings before there were any.
--density: instead, what a baked density costs and errs beside the network's (`Quality.density`); out/density/SCENE.png shows
many samples of the network unfiltered, the network filtered, and baked.
--passes: instead, the error of pictures whose number of paths was not known from the start, beside those of other samplers.
--halves: instead, what a texture costs that is kept in half precision, as large ones are, beside one that is widened.
"""

import argparse
import re
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rates import matrix_rate
from mesoshell.io.bundle import read_bundle
from mesoshell.io.image import write_png
from mesoshell.io.material import find
from mesoshell.measure.flip import flip
from mesoshell.pathtracer import levels, load_dict, load_file
from mesoshell.pathtracer.passes import render_pass
from mesoshell.render.effects import Effect, Effects
from mesoshell.render.quality import PRESETS

import mitsuba as mi  # isort: skip  (after mesoshell.pathtracer, which names a libLLVM that works)

SCENES = Path(__file__).parents[1] / "experiments" / "scenes"
GOAL = 0.05
#: Every sample is decoded: as the figure's 32 steps a ray ask for.
STEPS = PRESETS["normal"].with_changes(samples=32, spacing="length", skip=0.0, early_stop=0.0, weight_cut=1.0 - 1e-7)


#: What a path may leave out; quadrature is in the place of drawn collisions.
GATED = ("environment", "area_light", "mesh_shadow", "object_shadow", "shell_shadow", "bounces", "roulette")
GATED += ("camera_in_shell", "filtering", "quadrature")


def seconds(what) -> float:
    begin = time.perf_counter()
    what()
    return time.perf_counter() - begin


def shot(scene: mi.Scene, spp: int, seed: int = 0) -> np.ndarray:
    return np.array(mi.render(scene, spp=spp, seed=mi.UInt32(seed)))[..., :3]


def multiplications() -> int:
    """Of a sample's σ: the trunk and its last layer."""
    arrays = read_bundle(find("grass")).arrays
    return sum(a.size for k, a in arrays.items() if k.endswith("kernel") and ("trunk" in k or "sigma" in k))


def decoding(side: int) -> None:
    """A plane that fills the picture, seen from above: 32 samples a ray, and 32 on the way from the ground to the sun."""
    view = mi.ScalarTransform4f().look_at([0.05, 2.5, 0.05], [0, 0, 0], [0, 0, 1])
    film = {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}}
    plane = {"type": "obj", "filename": str(SCENES / "plane.obj"), "to_world": mi.ScalarTransform4f().scale(4)}
    turf = {"type": "mesoshell", "material": "grass", "thickness": 1.0, "scale": 1.0}
    scene: Any = load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": {"type": "perspective", "fov": 40, "to_world": view, "film": film},
            "sun": {"type": "directional", "direction": [-0.3, -1.0, 0.2], "irradiance": 3.0},
            "plane": plane | {"bsdf": turf},
        },
        STEPS,
    )
    first = seconds(lambda: shot(scene, 1))
    before = scene.integrator().context.queries
    times = [seconds(lambda seed=seed: shot(scene, 1, seed)) for seed in range(1, 6)]
    queries = (scene.integrator().context.queries - before) / 5
    rate, floor = queries / min(times), matrix_rate() / (2 * multiplications())
    print(
        f"{side}², {queries / side**2:.0f} samples a ray: {rate / 1e6:.1f} M decoded a second, {rate / floor:.2f} of the"
    )
    print(f"  matrix rate's {floor / 1e6:.0f} M; first picture {first:.1f} s, the next {min(times):.2f} s")


def to_goal(name: str, side: int, spp: int = 16, passes: int = 6) -> None:
    """Seconds until the mean error of a pixel is GOAL of the mean, from the spread of independent pictures."""
    begin = time.perf_counter()
    scene: Any = load_file(SCENES / f"{name}.xml", width=side, height=side)
    scene.integrator().context.bake()
    set_up = time.perf_counter() - begin
    first = seconds(lambda: shot(scene, spp))
    context = scene.integrator().context
    before, begin = context.queries, time.perf_counter()
    pictures = np.stack([shot(scene, spp, seed) for seed in range(1, passes + 1)])
    each = (time.perf_counter() - begin) / passes
    queries = (context.queries - before) / passes / each
    error = pictures.std(axis=0, ddof=1).mean() / pictures.mean()
    needed = each * (error / GOAL) ** 2
    bare = mi.load_file(str(_bare(name)), width=str(side), height=str(side))
    shot(bare, spp)
    plain = min(seconds(lambda seed=seed: shot(bare, spp, seed)) for seed in range(3))
    print(
        f"{name}: set up {set_up:.1f} s, first picture {first:.1f} s; {side**2 * spp / each:,.0f} paths a second, "
        f"{plain / each:.3f} of stock path's on bare meshes; {queries / 1e6:.1f} M decoded a second; "
        f"error {error:.1%} at {spp} spp, {GOAL:.0%} after {needed:.0f} s"
    )


def later(name: str, side: int, spp: int = 16, passes: int = 12) -> None:
    """Against the camera's own cone (0): how far the picture is from it, noise taken off, and what a path costs."""
    plain = None
    for spread in (0.0, 0.25, 0.5, 0.95):
        quality = PRESETS["normal"].with_changes(density="network", bounce_spread=spread)
        scene: Any = load_file(SCENES / f"{name}.xml", quality, width=side, height=side)
        shot(scene, spp)
        begin = time.perf_counter()
        many = np.stack([shot(scene, spp, seed + int(1000 * spread)) for seed in range(1, passes + 1)])
        each = (time.perf_counter() - begin) / passes / side**2 / spp
        mean, noise = many.mean(axis=0), many.var(axis=0, ddof=1).mean() / passes
        plain = (mean, noise) if plain is None else plain
        apart = max(np.square(mean - plain[0]).mean() - noise - plain[1], 0) ** 0.5 / plain[0].mean()
        means = mean.mean() / plain[0].mean() - 1
        print(
            f"| {name} | {spread} | {apart:.1%} | {means:+.2%} | {noise**0.5 / mean.mean():.1%} | {each * 1e6:.1f} |",
            flush=True,
        )


def spacings(name: str, side: int) -> None:
    changes: list[dict[str, Any]] = [{"samples": 160, "spacing": "length", "skip": 0.01}]
    changes += [{"samples": 48, "spacing": "length", "height_filter": 1.0}, {"spacing": "length"}, {}]
    changes += [{"samples": 14}, {"samples": 10}, {"samples": 10, "height_filter": 0.2}]
    beside(name, side, [{"density": "network"} | changed for changed in changes])


def densities(name: str, side: int) -> None:
    network: dict[str, Any] = {"density": "network"}
    fine = network | {"samples": 80, "filtering": False}
    first = network | {"samples": 48, "spacing": "length", "height_filter": 1.0, "footprint": 1.0, "anisotropy": 1}
    ways = [fine, first, network, network | {"filtering": False}, {}, {"samples": 40}, {"samples": 14}]
    means = beside(name, side, ways)
    path = Path("out/density") / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    strip = np.concatenate([means[k] for k in (0, 2, 4)], axis=1)
    write_png(path, strip.repeat(4, axis=0).repeat(4, axis=1))


def beside(name: str, side: int, settings: list[dict[str, Any]], spp: int = 16, passes: int = 8) -> list[np.ndarray]:
    """Against the first settings: how far pictures of the others are from it, noise taken off, what a path costs, and seconds
    of set-up. Their means, linear."""
    plain, means = None, []
    for changed in settings:
        begin = time.perf_counter()
        scene: Any = load_file(
            SCENES / f"{name}.xml", PRESETS["normal"].with_changes(**changed), width=side, height=side
        )
        scene.integrator().context.bake()
        set_up = time.perf_counter() - begin
        shot(scene, spp)
        before, took, many = scene.integrator().context.queries, [], []
        for seed in range(1, passes * (1 if plain else 2) + 1):
            begin = time.perf_counter()
            many.append(shot(scene, spp, seed + 1000 * (plain is None)))
            took.append(time.perf_counter() - begin)
        mean, noise = np.mean(many, axis=0), np.var(many, axis=0, ddof=1).mean() / len(many)
        means.append(mean)
        queries = (scene.integrator().context.queries - before) / len(many) / side**2 / spp
        plain = plain or (mean, noise)
        apart = max(np.square(mean - plain[0]).mean() - noise - plain[1], 0) ** 0.5 / plain[0].mean()
        what = ", ".join(f"{k} {v}" for k, v in changed.items()) or "normal"
        print(
            f"| {name} | {what} | {queries:.1f} | {min(took) / side**2 / spp * 1e6:.1f} | {set_up:.1f} | "
            f"{(noise * len(many)) ** 0.5 / plain[0].mean():.1%} | {apart:.1%} | {mean.mean() / plain[0].mean() - 1:+.1%} | "
            f"{flip(*(np.clip(x, 0, 1) for x in (plain[0], mean))):.3f} |",
            flush=True,
        )
    return means


def of_passes(name: str, side: int, turns: int = 3) -> None:
    """FLIP of so many paths a pixel: of passes that are independent, of passes as a goal has them, and multijittered."""
    size, every = {"width": side, "height": side}, np.arange(side * side)
    scene = load_file(SCENES / f"{name}.xml", **size)
    true = np.mean([shot(scene, 64, 10**6 + seed) for seed in range(16)], axis=0)
    for n in (4, 9, 16, 36):
        errors = []
        for turn in range(turns):
            seeds = range(64 * turn, 64 * turn + n)
            single = [shot(scene, 1, seed) for seed in seeds]
            even = [render_pass(scene, every, k)[:, :3].reshape(side, side, 3) for k in seeds]
            errors.append([flip(np.mean(x, axis=0), true) for x in (single, even, [shot(scene, n, turn)])])
        print(f"| {name} | {n} | {' | '.join(f'{x:.3f}' for x in np.mean(errors, axis=0))} |", flush=True)


def slab(light: dict[str, Any], side: int) -> dict[str, Any]:
    """A flat lawn of 40 × 40 patches, all that there is, under one light."""
    view = mi.ScalarTransform4f().look_at([0, 4, 9], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 8},
        "sensor": {"type": "perspective", "fov": 40, "to_world": view, "film": film},
        "light": light,
        "plane": {
            "type": "obj",
            "filename": str(SCENES / "plane.obj"),
            "to_world": mi.ScalarTransform4f().scale(4),
            "bsdf": {"type": "mesoshell", "material": "grass", "thickness": 0.1, "scale": 0.2},
        },
    }


def gates(name: str, scene: Any, spp: int = 16, turns: int = 6) -> None:
    """Seconds of pictures with all effects compiled over those with what is planned, in turn; and until both are as noisy."""
    context = scene.integrator().context
    plan: Effects = context.effects
    every = {n: Effect(n != "quadrature", "for the benchmark") for n in GATED}
    took, shown, ways = ([], []), ([], []), (plan, replace(plan, **every))
    for turn in range(turns + 1):
        for way, effects in enumerate(ways):
            context.effects, begin = effects, time.perf_counter()
            shown[way].append(shot(scene, spp, turn))
            took[way].append(time.perf_counter() - begin)
    gated, full = (min(times[1:]) for times in took)  # the first ones compile
    quiet, noisy = (np.var(pictures, axis=0, ddof=1).mean() for pictures in shown)
    off = ", ".join(n.replace("_", " ") for n in GATED if n != "quadrature" and not getattr(plan, n).on)
    first = took[1][0] / took[0][0]
    print(f"| {name} | {off} | {full / gated:.2f} | {full * noisy / gated / quiet:.2f} | {first:.2f} |", flush=True)


def halves(name: str, side: int, spp: int = 16, turns: int = 7) -> None:
    """Seconds of pictures with a texture in half precision over those with the same one widened, in turn."""
    scenes, widened = [], levels.MAX_WIDENED
    for limit in (widened, 0):
        levels.MAX_WIDENED = limit
        quality = PRESETS["normal"].with_changes(density="network")
        scenes.append(load_file(SCENES / f"{name}.xml", quality, width=side, height=side))
        shot(scenes[-1], spp)
    levels.MAX_WIDENED = widened
    took = np.array([[seconds(lambda s=s, k=k: shot(s, spp, k)) for s in scenes] for k in range(turns)])
    print(f"| {name} | {np.median(took[:, 1] / took[:, 0]):.2f} |", flush=True)


def _bare(name: str) -> Path:
    """The scene without its shells."""
    text = (SCENES / f"{name}.xml").read_text()
    text = re.sub(r'<bsdf type="mesoshell">.*?</bsdf>(\s*</bsdf>)?', '<bsdf type="diffuse"/>', text, flags=re.S)
    text = re.sub(r'value="([^"]*\.obj)"', lambda m: f'value="{(SCENES / m[1]).resolve()}"', text)
    path = Path(tempfile.mkdtemp()) / f"{name}.xml"
    path.write_text(text)
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--side", type=int, default=192, help="pixels along a side of the three scenes' pictures")
    parser.add_argument("--later", action="store_true", help="measure footprints after events")
    parser.add_argument("--spacing", action="store_true", help="measure samples by density and by length")
    parser.add_argument("--density", action="store_true", help="measure a baked density and the network's")
    parser.add_argument("--passes", action="store_true", help="measure errors of paths that are even in any number")
    parser.add_argument("--gates", action="store_true", help="measure what effects that are off save")
    parser.add_argument("--halves", action="store_true", help="measure what half precision of a texture costs")
    asked = parser.parse_args()
    if asked.gates:
        filtered = PRESETS["normal"].with_changes(density="network")
        print("| scene | off | a picture | the same noise | the first picture |\n|---|---|---|---|---|")
        lights = {"sun": {"type": "directional", "direction": [-0.3, -1.0, 0.2]}, "sky": {"type": "constant"}}
        for name, light in lights.items():
            gates(f"a lawn under a {name}", load_dict(slab(light, asked.side), filtered))
        for name in ("spot", "room", "field"):
            gates(name, load_file(SCENES / f"{name}.xml", filtered, width=asked.side, height=asked.side))
        return
    if asked.halves:
        print("| scene | half precision over widened |\n|---|---|")
    elif asked.spacing or asked.density:
        print(f"| scene | settings | σ a path | µs a path | set up, s | noise | pixel | mean | FLIP |\n{'|---' * 9}|")
    elif asked.passes:
        print("| scene | paths | independent | passes | multijittered |\n|---|---|---|---|---|")
    elif asked.later:
        print("| scene | spread | pixel, off 0 | mean, off 0 | noise | µs a path |\n|---|---|---|---|---|---|")
    else:
        decoding(256)
    ways = [(asked.halves, halves), (asked.spacing, spacings), (asked.density, densities)]
    ways += [(asked.passes, of_passes), (asked.later, later)]
    measure = next((way for wanted, way in ways if wanted), to_goal)
    for name in ("spot", "room", "field"):
        measure(name, asked.side)


if __name__ == "__main__":
    main()
