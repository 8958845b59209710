"""A march against the surface material distilled from it: python -m benchmarks.twins grass_twin.npz [--out plot.png]

One view of a sphere, a torus and a cow, with patches of a tenth of the mesh (near), and of an eighth of that (far). What both
are compared with is a march of 256 samples, 16 rays a pixel. Prints FLIP and IoU of what is opaque, network evaluations
a ray, and seconds of a picture once its mesh is made ready, for marches of 8 to 128 samples and for the surface material: far
the twin, near another one, of all footprints, if there is one.
"""

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
import tyro

from benchmarks.silhouettes import SPOT, over, torus
from mesoshell.cli.description import Description, describe
from mesoshell.cli.marching import facts, scene_of
from mesoshell.cli.render import Options as Render
from mesoshell.cli.standing import in_place, twin_facts
from mesoshell.geometry.mesh import is_convex
from mesoshell.io.bundle import read_bundle
from mesoshell.io.image import tonemap
from mesoshell.io.surface import read_surface
from mesoshell.io.twin import Twin
from mesoshell.measure.flip import flip
from mesoshell.render.camera import Camera
from mesoshell.render.effects import plan_effects
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.shell import renderer as march
from mesoshell.shell.scene import Scene
from mesoshell.silhouette import renderer as surface
from mesoshell.silhouette.ready import ready

#: Length of a patch over the largest side of a mesh.
VIEWS = {"near": 0.1, "far": 0.0125}
SIDE = 128
SAMPLES = (8, 16, 32, 64, 128)
TRUE = PRESETS["normal"].with_changes(samples=256, pixel_samples=16, early_stop=0.0, skip=0.0, weight_cut=0.0)


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
    bundle, points = read_bundle(given.bundle), []
    assert bundle.twin is not None, f"{given.bundle}: has no twin"
    depth = bundle.twin.surface.depth
    near = given.surface and replace(bundle.twin, surface=read_surface(given.surface))
    print("| mesh | view | | FLIP | IoU | evaluations a ray | seconds |\n|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        ball = Path(folder) / "sphere.ply"
        trimesh.creation.icosphere(4).export(ball)
        meshes = {"sphere": ball, "torus": torus(Path(folder) / "torus.obj"), "spot": SPOT}
        for name, mesh in meshes.items():
            for view, length in VIEWS.items():
                patch = length * float(np.ptp(trimesh.load(mesh, force="mesh").bounds, axis=0).max())
                options = Render(mesh, thickness=depth * patch, scale=patch, size=(SIDE, SIDE), base=bundle.twin.base)
                d = describe(options, bundle)
                scene = scene_of(d)
                true, *_ = marched(scene, TRUE)
                tried = [(f"march, {n}", marched(scene, PRESETS["normal"].with_changes(samples=n))) for n in SAMPLES]
                twin = near if view == "near" else bundle.twin
                if twin is not None:
                    found = twin_facts(options, replace(bundle, twin=twin), d, PRESETS["normal"])
                    whose = f"distilled ({found.misfit})" if found and found.misfit else "distilled"
                    tried.append((whose, distilled(d, twin, PRESETS["normal"])))
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


def distilled(d: Description, twin: Twin, quality: Quality) -> tuple[np.ndarray, float, float]:
    """The same of the surface material."""
    standing = surface.SurfaceScene(**vars(in_place(d)), ready=ready(twin.surface))
    effects = surface.plan(standing, is_convex(standing.mesh))
    surface.render(standing, quality, effects)
    begin = time.perf_counter()
    image, report = surface.render(standing, quality, effects)
    seconds = time.perf_counter() - begin - report.seconds["prepare"]
    return image, asked(report.counts, d.camera, quality), seconds


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
        for _, _, error, seconds in [row for row in points if row[0] == scene and row not in marches]:
            axes.plot(seconds, error, marker="D", linestyle="", label="distilled")
        axes.set(title=scene, xlabel="seconds a picture", ylabel="FLIP")
    figure.axes[1].legend()
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    main(tyro.cli(Options))
