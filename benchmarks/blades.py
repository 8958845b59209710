"""A shell against the blades that it was made from: python -m benchmarks.blades [--side 256] [--folder out]

The recipe's own patch of blades (the one that the bundled grass shows) as triangles, repeated over a plane, and the bundled
grass as a shell over the same plane: same camera, same lights, both in Mitsuba. Prints the shell's error against the
converged blades, seconds that each needs to be as close as the shell comes, and writes pairs of pictures. `memory` prints
what blades take that are all their own, as triangles and as curves, and what a shell takes: of one texture that repeats, and
of one with texels of its own for each patch, as a generator's is.
"""

import argparse
import dataclasses
import multiprocessing
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import leaf
from data_gen import grass
from mesoshell.io.bundle import MANIFEST, checked_manifest, read_bundle
from mesoshell.io.image import write_png
from mesoshell.io.material import find
from mesoshell.measure.flip import flip
from mesoshell.pathtracer import load_dict

import mitsuba as mi  # isort: skip  (after mesoshell.pathtracer)

AGE, PATCH = 0.2, 0
#: Level of the bundled grass whose texels a patch are a generator's, and cells of a σ grid along a patch's side there.
OWN_LEVEL, CELLS = 2, 8
#: Patches along the side of what is made at a time.
TILE = 32
#: Times are until a picture's error is so many times that of the converged shell.
WITHIN = 1.25
GROUND = (0.09, 0.06, 0.035)
T = mi.ScalarTransform4f
SUN: dict[str, Any] = {"type": "directional", "direction": [-0.5, 0.3, -0.8], "irradiance": 12.0}
LIGHTS: dict[str, dict[str, Any]] = {
    "sun": {"sun": SUN},
    "sun and sky": {"sun": SUN, "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1.2, 1.5, 2.0]}}},
}
#: Patches along the plane's side; the camera's place and target, patches; vertical angle of view.
VIEWS = {"near": (8, (1.2, -3.6, 3.4), (0.0, 0.0, 0.4), 32), "far": (40, (2.0, -24.0, 4.0), (0.0, -8.0, 0.5), 34)}


#: Of a blade's vertices: 0 at the root, 1 at the tip.
ALONG = np.append(np.repeat(np.arange(grass.ROWS - 1), 2), grass.ROWS - 1) / (grass.ROWS - 1)


def blades(rng: np.random.Generator, side: int, age: float = AGE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (n, K, 3) of the blades of side × side patches, with R and T at each."""
    grown = grass.grow(rng, side, {})
    points, own = grown.points, grown.own
    dead = np.clip(1.5 * age - 0.5 * own["resist"] + own["dry"], 0, 1)[:, None, None]
    shade = ((0.75 * ALONG + 0.45) * (0.5 * own["tone"] + 0.75)[:, None])[..., None]
    pairs = ((grass.FRESH_R, grass.DEAD_R), (grass.FRESH_T, grass.DEAD_T))
    reflect, transmit = (shade * ((1 - dead) * np.array(a) + dead * np.array(b)) for a, b in pairs)
    return points, reflect, transmit


def mesh(points: np.ndarray, reflect: np.ndarray, transmit: np.ndarray) -> mi.Mesh:
    """Strips of triangles. R and T are linear along a blade: textures have a column for each, root and tip in two rows."""
    n, k = points.shape[:2]
    faces = (np.arange(n)[:, None, None] * k + grass.strip_triangles(grass.ROWS)).reshape(-1, 3)
    uv = np.stack(np.broadcast_arrays((np.arange(n)[:, None] + 0.5) / n, 0.25 + 0.5 * ALONG), axis=-1)
    props = mi.Properties()
    props["bsdf"] = mi.load_dict({"type": "grass_leaf", "reflect": ends(reflect), "transmit": ends(transmit)})
    made = mi.Mesh("blades", n * k, len(faces), props=props, has_vertex_normals=True, has_vertex_texcoords=True)
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = mi.Float(points.astype(np.float32).ravel())
    parameters["vertex_texcoords"] = mi.Float(uv.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    parameters.update()
    made.recompute_vertex_normals()
    return made


def ends(colour: np.ndarray) -> dict[str, Any]:
    """(n, K, 3) as a picture of two rows, v = 0 in the first."""
    picture = np.ascontiguousarray(colour[:, [0, -1]].swapaxes(0, 1), np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(picture), "raw": True, "wrap_mode": "clamp"}


def plane(side: int) -> dict[str, Any]:
    """A square of whole patches about the origin, z = 0."""
    a = side / 2
    corners = [(-a, -a, 0, 0), (a, -a, 1, 0), (a, a, 1, 1), (-a, a, 0, 1)]
    lines = [f"v {x} {y} 0\nvt {u} {v}" for x, y, u, v in corners]
    path = Path(tempfile.mkdtemp()) / "plane.obj"
    path.write_text("\n".join([*lines, "f 1/1 2/2 3/3", "f 1/1 3/3 4/4"]))
    return {"type": "obj", "filename": str(path)}


def stage(view: str, lights: str, pixels: int, depth: int) -> dict[str, Any]:
    _, eye, target, angle = VIEWS[view]
    film = {"type": "hdrfilm", "width": pixels, "height": pixels, "rfilter": {"type": "box"}}
    pose: Any = T().look_at(eye, target, [0, 0, 1])
    camera = {"type": "perspective", "fov": angle, "to_world": pose, "film": film}
    return {"type": "scene", "integrator": {"type": "path", "max_depth": depth}, "sensor": camera, **LIGHTS[lights]}


def of_blades(view: str, lights: str, pixels: int) -> mi.Scene:
    """All blades as one mesh: instances of a patch, whose bounds overlap, take 140 µs a path from far away, and this 1."""
    side = VIEWS[view][0]
    scene = stage(view, lights, pixels, 16)
    at = np.arange(side) - side / 2
    corner = np.stack([*np.meshgrid(at, at), np.zeros((side, side))], axis=-1).reshape(-1, 1, 1, 3)
    patch, *colours = blades(np.random.default_rng(PATCH), 1)
    points = (corner + patch).reshape(-1, *patch.shape[1:])
    scene["ground"] = plane(side) | {"bsdf": diffuse()}
    scene["blades"] = mesh(points, *(np.tile(c, (side * side, 1, 1)) for c in colours))
    return mi.load_dict(scene)


def of_shell(view: str, lights: str, pixels: int) -> mi.Scene:
    scene = stage(view, lights, pixels, 2 if lights == "sun" else 4)
    turf = {"type": "mesoshell", "material": "grass", "thickness": 1.0, "scale": 1.0, "age": AGE, "ground": diffuse()}
    return load_dict(scene | {"turf": plane(VIEWS[view][0]) | {"bsdf": turf}})


def diffuse() -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(GROUND)}}


def pictures(scene: mi.Scene, spp: int, passes: int) -> tuple[np.ndarray, float]:
    """Independent pictures (passes, H, W, 3), and seconds for one."""
    shot = lambda seed: np.array(mi.render(scene, spp=spp, seed=mi.UInt32(seed)))[..., :3]  # noqa: E731
    shot(0)
    begin = time.perf_counter()
    many = np.stack([shot(seed) for seed in range(1, passes + 1)])
    return many, (time.perf_counter() - begin) / passes


def blocks(image: np.ndarray, n: int = 4) -> np.ndarray:
    h, w = (x // n * n for x in image.shape[:2])
    return image[:h, :w].reshape(h // n, n, w // n, n, 3).mean(axis=(1, 3))


def shown(image: np.ndarray) -> np.ndarray:
    return image / (1 + image)


def compare(view: str, lights: str, pixels: int, folder: Path, spp: int, passes: int) -> None:
    """Rows of the table, and a pair of pictures."""
    true, its = pictures(of_blades(view, lights, pixels), spp, passes)
    ours, mine = pictures(of_shell(view, lights, pixels), spp, passes)
    write_png(folder / f"blades_{view}_{lights.split()[-1]}.png", pair(true.mean(axis=0), ours.mean(axis=0)))
    for name, reduce in (("pixel", lambda x: x), ("4 × 4 pixels", blocks)):
        a, b = (np.stack([reduce(x) for x in many]) for many in (true, ours))
        mean = a.mean()
        spread = [float(np.sqrt(x.var(axis=0, ddof=1).mean()) / mean) for x in (a, b)]
        a, b = a.mean(axis=0), b.mean(axis=0)
        apart = max(np.square(a - b).mean() / mean**2 - (spread[0] ** 2 + spread[1] ** 2) / passes, 0) ** 0.5
        # squares of errors add: at WITHIN times its own error, a shell still has √(WITHIN² − 1) of it as noise
        seconds = its * (spread[0] / (WITHIN * apart)) ** 2, mine * (spread[1] / apart) ** 2 / (WITHIN**2 - 1)
        each = [x / spp / pixels**2 * 1e6 for x in (its, mine)]
        print(
            f"| {view}, {lights} | {name} | {apart:.0%} | {b.mean() / mean - 1:+.1%} | {flip(shown(a), shown(b)):.3f} | "
            f"{seconds[0]:.2f} | {seconds[1]:.2f} | {each[0]:.1f} | {each[1]:.1f} |",
            flush=True,
        )


def pair(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    gap = np.ones((len(a), 8, 3))
    return np.concatenate([shown(a), gap, shown(b)], axis=1)


def memory(kind: str, count: int) -> None:
    """Peak memory, and seconds to a first small picture, of what is asked for; in a process of its own."""
    side = max(round((count / 220) ** 0.5), 1)
    side -= side % -(-side // TILE)
    leaf.register()
    with tempfile.TemporaryDirectory() as folder:
        if kind == "own texels":  # in yet another process: what making it takes is not asked
            making = multiprocessing.get_context("spawn").Process(target=own_texels, args=(Path(folder), side))
            making.start()
            making.join()
            if making.exitcode:
                sys.exit(f"making it ended with {making.exitcode}")
        begin = time.perf_counter()
        scene: Any
        if kind in ("triangles", "curves"):
            scene = {"triangles": unique, "curves": curves}[kind](side)
        else:
            scene = shell(side, "grass" if kind == "shell" else folder)
        mi.render(scene, spp=1).numpy()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    print(f"| {side**2 * 220:,} | {side**2:,} | {kind} | {peak:,.0f} MiB | {time.perf_counter() - begin:.1f} s |")


def overview(side: int) -> dict[str, Any]:
    film = {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}}
    pose: Any = T().look_at([0, -side, side], [0, 0, 0], [0, 0, 1])
    camera = {"type": "perspective", "fov": 40, "to_world": pose, "film": film}
    return {"type": "scene", "integrator": {"type": "path", "max_depth": 2}, "sensor": camera, "sun": SUN}


def unique(side: int) -> mi.Scene:
    points, reflect, transmit = (np.concatenate(parts) for parts in zip(*tiles(side), strict=True))
    return mi.load_dict(overview(side) | {"blades": mesh(points, reflect, transmit)})


def curves(side: int) -> mi.Scene:
    """Round ones, as wide as the blades, of four control points each."""
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
        for points, *_ in tiles(side):
            pairs = points[:, :-1].reshape(len(points), -1, 2, 3)
            middle = np.concatenate([pairs.mean(axis=2), points[:, -1:]], axis=1)[:, ::2]
            radius = np.linalg.norm(pairs[:, :, 0] - pairs[:, :, 1], axis=-1) / 2
            radius = np.concatenate([radius, np.full((len(points), 1), 1e-4)], axis=1)[:, ::2]
            for strand in np.concatenate([middle, radius[..., None]], axis=-1):
                np.savetxt(file, strand, fmt="%.5g")
                file.write("\n")
        file.flush()
        return mi.load_dict(overview(side) | {"blades": {"type": "bsplinecurve", "filename": file.name}})


def tiles(side: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Blades of side × side patches, TILE² at a time, as a scene keeps them: vertices in float32, and R and T at the ends."""
    rng, n = np.random.default_rng(0), -(-side // TILE)
    for i in range(n * n):
        points, *colours = blades(rng, side // n)
        corner = (np.array([i % n, i // n, 0]) - [n / 2, n / 2, 0]) * (side // n)
        yield (points + corner).astype(np.float32), *(c[:, [0, -1]].astype(np.float32) for c in colours)


def shell(side: int, material: str) -> mi.Scene:
    turf = {"type": "mesoshell", "material": material, "thickness": 1.0, "scale": 1.0, "age": AGE}
    return load_dict(overview(side) | {"turf": plane(side) | {"bsdf": turf}})


def own_texels(folder: Path, side: int) -> None:
    """The bundled grass as a texture of side × side patches that does not repeat, as `mesoshell texture` writes it."""
    grass_bundle = read_bundle(find("grass"))
    arrays = {k: v for k, v in grass_bundle.arrays.items() if not k.startswith(("features/", "grid/"))}
    arrays["correction"] = arrays["correction"][OWN_LEVEL:]
    levels = sum(k.startswith("features/") for k in grass_bundle.arrays) - OWN_LEVEL
    for i in range(levels):
        texels = grass_bundle.arrays[f"features/{i + OWN_LEVEL}"]
        cells = grass_bundle.arrays[f"grid/{i + OWN_LEVEL}"]
        n, most = len(texels), min(CELLS, len(texels))
        wide = cells.reshape(len(cells), most, n // most, most, n // most).max(axis=(2, 4))
        arrays |= {f"features/{i}": np.tile(texels, (side, side, 1)), f"grid/{i}": np.tile(wide, (1, side, side))}
    density = len(grass_bundle.arrays[f"features/{OWN_LEVEL}"])
    made = dataclasses.replace(grass_bundle, texel_density=density, wraps=False, arrays=arrays)
    (folder / MANIFEST).write_bytes(checked_manifest(folder, made))
    for key, value in arrays.items():
        (folder / f"{key}.npy").parent.mkdir(parents=True, exist_ok=True)
        np.save(folder / f"{key}.npy", value)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("pictures", "memory"), nargs="?", default="pictures")
    parser.add_argument("--side", type=int, default=256, help="pixels along a picture's side")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--passes", type=int, default=16)
    parser.add_argument("--folder", type=Path, default=Path("out"))
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        memory(asked.one[0], int(asked.one[1]))
    elif asked.what == "memory":
        print(
            "| blades | patches | kept as | peak memory | seconds to a first picture |\n|---|---|---|---|---|",
            flush=True,
        )
        for count in (1e3, 1e4, 1e5, 1e6, 1e7):
            for kind in ("triangles", "curves", "shell", "own texels"):
                command = [sys.executable, "-m", "benchmarks.blades", "--one", kind, str(int(count))]
                done = subprocess.run(command, capture_output=True, text=True)
                print(done.stdout.strip() or f"| {count:,.0f} | | {kind} | exit {done.returncode} | |", flush=True)
    else:
        leaf.register()
        asked.folder.mkdir(exist_ok=True)
        print("| view | of a | error | its mean | FLIP | seconds: blades | shell | µs a path: blades | shell |")
        print("|---|---|---|---|---|---|---|---|---|")
        for view in VIEWS:
            for lights in LIGHTS:
                compare(view, lights, asked.side, asked.folder, asked.spp, asked.passes)


if __name__ == "__main__":
    main()
