"""A march, the surface material distilled from it, and blades: python -m benchmarks.twins grass_twin.npz [--out plot.png]

One view of a sphere, a torus and a cow, with patches of a tenth of the mesh (near), and of a fifth of that (far). What all
are compared with is a march of 256 samples, 16 rays a pixel. Prints FLIP and IoU of what is opaque, network evaluations
a ray, and seconds of a picture once its mesh is made ready, for marches of 8 to 128 samples and for the surface material: far
the twin, near another one, of all footprints, if there is one; and for the blades that the shell was made from, as triangles on
the same mesh, path-traced with 256 paths a pixel (its seconds are for as many as the others have rays). Blades across seams of
the sphere's and the cow's texture are missing.
"""

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import tyro

import mesoshell as ms
from benchmarks import leaf
from benchmarks.blades import PATCH, blades
from benchmarks.silhouettes import SPOT, over, torus
from data_gen import grass
from mesoshell.datasets.queries.dress import apply_mesostructure
from mesoshell.datasets.queries.tile import Tile
from mesoshell.geometry.mesh import load_mesh, uv_stretch
from mesoshell.io.image import tonemap
from mesoshell.io.surface import read_surface
from mesoshell.io.twin import Twin
from mesoshell.measure.flip import flip
from mesoshell.pathtracer import scene_dict
from mesoshell.render.camera import Camera
from mesoshell.render.effects import plan_effects
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.scene.lod import describe_twin, twin_facts
from mesoshell.scene.render_shell import facts, marched_scene
from mesoshell.scene.setup import ShellDescription, describe_shell
from mesoshell.shell.render import renderer as march
from mesoshell.shell.render.scene import Scene
from mesoshell.surface_material import renderer as surface
from mesoshell.surface_material.loader import load_device_material

import mitsuba as mi  # isort: skip  (after mesoshell.pathtracer)

#: Length of a patch over the largest side of a mesh.
VIEWS = {"near": 0.1, "far": 0.02}
#: Of the torus, texture units: both of its sides are so many times as long.
WHOLE = {"near": 0.3, "far": 0.06}
#: Pixels along a picture's side: far, one is wider than a patch, for which a twin is learned.
SIDES = {"near": 128, "far": 64}
SAMPLES = (8, 16, 32, 64, 128)
PATHS = 256
TRUE = PRESETS["normal"].with_changes(
    samples=256,
    pixel_samples=16,
    density="network",
    spacing="length",
    early_stop=0.0,
    skip=0.0,
    weight_cut=0.0,
    light_samples=0,
)


@dataclass(frozen=True)
class Options:
    """What to compare."""

    #: The shell's bundle with the surface material in it (`mesoshell distill --twin`).
    bundle: tyro.conf.Positional[Path]
    #: A plot of FLIP against seconds.
    out: Path | None = None
    #: A surface material of all footprints, of the same shell (`mesoshell distill --out`).
    surface: Path | None = None


def main(given: Options) -> None:
    leaf.register()
    material, points = ms.load_material(given.bundle), []
    bundle = material.shell
    assert bundle.twin is not None, f"{given.bundle}: has no twin"
    assert [p.name for p in bundle.parameters] == ["age"], f"{given.bundle}: is no grass, and blades are"
    depth = bundle.twin.surface.depth
    near = given.surface and replace(bundle.twin, surface=read_surface(given.surface))
    print("| mesh | view | | FLIP | IoU | evaluations a ray | seconds |\n|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        ball = Path(folder) / "sphere.ply"
        trimesh.creation.icosphere(4).export(ball)
        meshes = {"sphere": ball, "torus": torus(Path(folder) / "torus.obj"), "spot": SPOT}
        for name, mesh in meshes.items():
            for view, length in VIEWS.items():
                loaded = load_mesh(mesh)
                patch = length * float(np.ptp(loaded.vertices, axis=0).max())
                if name == "torus":  # a whole number of patches around: no seam
                    patch = uv_stretch(loaded) * WHOLE[view]
                size, base = (SIDES[view],) * 2, bundle.twin.base
                wanted = ms.Scene(mesh, material, depth * patch, patch, size=size, base_colour=base)
                d = describe_shell(wanted)
                scene = marched_scene(d)
                true, *_ = marched(scene, TRUE)
                tried = [(f"march, {n}", marched(scene, PRESETS["normal"].with_changes(samples=n))) for n in SAMPLES]
                twin = near if view == "near" else bundle.twin
                if twin is not None:
                    with_twin = ms.Material(material.name, replace(bundle, twin=twin))
                    found = twin_facts(replace(wanted, material=with_twin), d, PRESETS["normal"])
                    whose = f"distilled ({found.misfit})" if found and found.misfit else "distilled"
                    tried.append((whose, distilled(d, twin, PRESETS["normal"])))
                image, seconds, count = traced(d)
                tried.append((f"{count:,} triangles", (image, 0.0, seconds)))
                for what, (image, queries, seconds) in tried:
                    a, b = true[..., 3] > 0.5, image[..., 3] > 0.5
                    error = float(flip(tonemap(over(true)), tonemap(over(image))))
                    iou = (a & b).sum() / (a | b).sum()
                    print(
                        f"| {name} | {view} | {what} | {error:.3f} | {iou:.4f} | {queries:.1f} | {seconds:.2f} |",
                        flush=True,
                    )
                    points.append((f"{name}, {view}", what, error, seconds))
    if given.out:
        plot(points, given.out)


def marched(scene: Scene, quality: Quality) -> tuple[np.ndarray, float, float]:
    """The picture, queries a ray, and seconds of a second one."""
    effects = plan_effects(facts(scene), quality)
    march.render(scene, quality, effects)
    begin = time.perf_counter()
    image, report = march.render(scene, quality, effects)
    return image, asked(report.counts, scene.camera, quality), time.perf_counter() - begin


def distilled(d: ShellDescription, twin: Twin, quality: Quality) -> tuple[np.ndarray, float, float]:
    """The same of the surface material."""
    standing = surface.SurfaceScene(**vars(describe_twin(d)), device_material=load_device_material(twin.surface))
    effects = surface.plan(standing, quality)
    surface.render(standing, quality, effects)
    begin = time.perf_counter()
    image, report = surface.render(standing, quality, effects)
    seconds = time.perf_counter() - begin - report.seconds["prepare"]
    return image, asked(report.counts, d.camera, quality), seconds


def traced(d: ShellDescription) -> tuple[np.ndarray, float, int]:
    """The picture of the recipe's blades where the shell is, seconds for `normal`'s rays a pixel, and triangles."""
    there = describe_twin(d)
    grown, *colours = blades(np.random.default_rng(PATCH), 1, float(d.alpha[0]))
    at, depth = grown.reshape(-1, 3), float(np.linalg.norm(d.shell.offset, axis=1).mean()) / there.period
    faces = np.arange(len(grown))[:, None, None] * grown.shape[1] + grass.strip_triangles(grass.ROWS)
    place = np.stack([at[:, 0], at[:, 1], (at[:, 2] - 1) * depth], axis=1)
    number = np.repeat(np.arange(len(at), dtype=float)[:, None], 3, axis=1)  # in the place of an albedo
    tile = Tile(place, faces.reshape(-1, 3), number, depth, (-1.0, -1.0, -1.0))
    points, faces, of = apply_mesostructure(tile, there.mesh, there.period)
    of = of[:, 0].astype(int)
    body = of[faces[:, 0]] < 0
    attributes = {name: c.reshape(-1, 3)[of] for name, c in zip(("reflect", "transmit"), colours, strict=True)}
    parts = {
        "blades": triangles(points, faces[~body], leaf_of(attributes), attributes),
        "body": triangles(points, faces[body], {"type": "diffuse", "reflectance": _rgb(d.base_colour)}, {}),
    }
    lights = {f"light{i}": scene_dict.distant(light) for i, light in enumerate(d.lights)}
    scene: Any = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 16, "hide_emitters": True},
            "sensor": scene_dict.sensor(d.camera, PATHS),
        }
        | parts
        | lights
    )
    mi.render(scene, spp=PATHS, seed=mi.UInt32(0)).numpy()
    begin = time.perf_counter()
    image = mi.render(scene, spp=PATHS, seed=mi.UInt32(1)).numpy()
    seconds = (time.perf_counter() - begin) * PRESETS["normal"].pixel_samples / PATHS
    return image, seconds, int((~body).sum())


def leaf_of(attributes: dict[str, np.ndarray]) -> dict[str, Any]:
    return {"type": "grass_leaf"} | {k: {"type": "mesh_attribute", "name": f"vertex_{k}"} for k in attributes}


def triangles(
    points: np.ndarray, faces: np.ndarray, bsdf: dict[str, Any], attributes: dict[str, np.ndarray]
) -> mi.Mesh:
    """Of these faces, with smooth normals."""
    used, faces = np.unique(faces, return_inverse=True)
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf)
    made = mi.Mesh("made", len(used), faces.size // 3, props=props, has_vertex_normals=True)
    for name, values in attributes.items():
        made.add_attribute(f"vertex_{name}", 3, values[used].astype(np.float32).ravel())
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = mi.Float(points[used].astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    parameters.update()
    made.recompute_vertex_normals()
    return made


def _rgb(colour: tuple[float, ...]) -> dict[str, Any]:
    return {"type": "rgb", "value": list(colour)}


def asked(counts: dict[str, int], camera: Camera, quality: Quality) -> float:
    """Evaluations of a network, of any of a material's, a camera ray."""
    rays = camera.width * camera.height * quality.pixel_samples
    return sum(n for name, n in counts.items() if name.endswith("queries")) / rays


def plot(points: list[tuple[str, str, float, float]], out: Path) -> None:
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(scene for scene, *_ in points))
    figure = Figure(figsize=(10, 5.5), layout="constrained")
    for axes, scene in zip(figure.subplots(2, 3, sharey="row").T.ravel(), scenes, strict=True):
        marches = [row for row in points if row[0] == scene and row[1].startswith("march")]
        axes.loglog([r[3] for r in marches], [r[2] for r in marches], marker="o", markersize=3, label="marched")
        for _, what, error, seconds in marches:
            axes.annotate(what.removeprefix("march, "), (seconds, error), fontsize=7)
        for _, what, error, seconds in [row for row in points if row[0] == scene and row not in marches]:
            explicit = what.endswith("triangles")
            axes.plot(
                seconds,
                error,
                marker="^" if explicit else "D",
                linestyle="",
                label="blades" if explicit else "distilled",
            )
        axes.set(title=scene, xlabel="seconds a picture", ylabel="FLIP")
    figure.axes[1].legend()
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    main(tyro.cli(Options))
