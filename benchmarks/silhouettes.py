"""A surface material against the geometry that it was learned from: python -m benchmarks.silhouettes weave weave.npz

The mesostructure as triangles on a mesh, path-traced, and the material on the same mesh by the JAX engine: same camera, same
three lights. Prints, for each mesh and length of a period: IoU of what is opaque; FLIP, and relative squared error where both
are; bias of the mean; seconds of both for 16 paths a pixel, and the material's queries. The geometry is traced twice: what its
two pictures differ by stands behind the slashes, and nothing below it is an error of the material's.
`--filter` renders with another curvature (Quality.curvature_filter).
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import mesoshell as ms
from mesoshell.datasets.queries.dress import apply_mesostructure
from mesoshell.datasets.queries.sources import source
from mesoshell.datasets.queries.tile import Tile
from mesoshell.geometry.mesh import Mesh, load_mesh, uv_stretch
from mesoshell.io.image import tonemap, write_png
from mesoshell.measure.flip import flip
from mesoshell.pathtracer import scene_dict
from mesoshell.render.quality import PRESETS, SETTINGS
from mesoshell.scene.setup import describe_surface
from mesoshell.surface_material.loader import load_device_material
from mesoshell.surface_material.renderer import SurfaceScene, plan, render
from mesoshell.surface_material.scene import SurfaceDescription

import mitsuba as mi  # isort: skip  (after mesoshell.pathtracer)

SPOT = Path(__file__).parent.parent / "tests/data/spot.obj"
#: Lengths of a period on the torus, whose tube is of radius 0.382: curvature up to 0.8, 1.6 and 3.1. All divide both ways
#: around.
PERIODS = (0.3, 0.6, 1.2)
BEHIND = np.array([0.18, 0.18, 0.35])


def torus(path: Path, around: int = 240, across: int = 96) -> Path:
    """6 around and 2.4 across, with UVs as long as these."""
    ring, tube = 6 / (2 * np.pi), 2.4 / (2 * np.pi)
    p, t = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.arange(across) * 2 * np.pi / across, indexing="ij")
    reach = ring + tube * np.cos(t)
    points = np.stack([reach * np.cos(p), tube * np.sin(t), -reach * np.sin(p)], axis=-1).reshape(-1, 3)
    u, v = np.meshgrid(np.arange(around + 1) / around * 6, np.arange(across + 1) / across * 2.4, indexing="ij")
    lines = [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in points]
    lines += [f"vt {x:.7f} {y:.7f}" for x, y in np.stack([u, v], axis=-1).reshape(-1, 2)]
    for a in range(around):
        for b in range(across):
            square = ((a, b), (a + 1, b), (a + 1, b + 1), (a, b + 1))
            corners = [(i % around * across + j % across + 1, i * (across + 1) + j + 1) for i, j in square]
            lines.append("f " + " ".join(f"{i}/{j}" for i, j in corners))
    path.write_text("\n".join(lines) + "\n")
    return path


def of_geometry(tile: Tile, mesh: Mesh, d: SurfaceDescription, spp: int) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Linear RGBA by path tracing, twice; seconds of one; and triangles."""
    points, faces, albedo = apply_mesostructure(tile, mesh, d.period)
    props = mi.Properties()
    colour = {"type": "mesh_attribute", "name": "vertex_albedo"}
    props["bsdf"] = mi.load_dict({"type": "twosided", "inner": {"type": "diffuse", "reflectance": colour}})
    props["face_normals"] = True
    made = mi.Mesh("geometry", len(points), len(faces), props=props)
    made.add_attribute("vertex_albedo", 3, albedo.astype(np.float32).ravel())
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = mi.Float(points.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    parameters.update()
    lights = {f"light{i}": scene_dict.distant(light) for i, light in enumerate(d.lights)}
    path = {"type": "path", "max_depth": 16, "hide_emitters": True}
    scene: Any = mi.load_dict(
        {"type": "scene", "integrator": path, "sensor": scene_dict.sensor(d.camera, spp), "made": made} | lights
    )
    image = np.array(mi.render(scene, spp=spp, seed=0))
    begin = time.perf_counter()
    again = np.array(mi.render(scene, spp=spp, seed=1))
    return image, again, time.perf_counter() - begin, len(faces)


def apart(true: np.ndarray, ours: np.ndarray) -> tuple[float, float, float, float]:
    """1 - IoU of what is opaque; FLIP; of where both are, relative squared error and bias of the mean."""
    a, b = true[..., 3] > 0.5, ours[..., 3] > 0.5
    inside, of_true = ours[a & b][:, :3], true[a & b][:, :3]
    error = ((inside - of_true) ** 2).sum() / (of_true**2).sum()
    flipped = float(flip(tonemap(over(true)), tonemap(over(ours))))
    return 1 - (a & b).sum() / (a | b).sum(), flipped, error, inside.mean() / of_true.mean() - 1


def compare(name: str, bundle: Path, mesh: Path, period: float | None, asked: argparse.Namespace) -> None:
    # a period is in texture units: triangles lie within the torus, so these are a little shorter in the world
    if period is not None:
        period *= uv_stretch(load_mesh(mesh))
    material = ms.load_material(bundle)
    side, lit = (asked.side, asked.side), {"irradiance": 4.0, "camera": asked.camera}
    d = describe_surface(ms.Scene(mesh, material, scale=period, size=side, **lit))
    one, two, traced, triangles = of_geometry(source(name), d.mesh, d, asked.spp // 2)
    true = (one + two) / 2
    scene = SurfaceScene(**vars(d), device_material=load_device_material(material.surface))
    quality = PRESETS["normal"].with_changes(pixel_samples=asked.samples, curvature_filter=asked.filter)
    effects = plan(scene, quality)
    render(scene, quality.with_changes(pixel_samples=1), effects)
    ours, report = render(scene, quality, effects)
    (missed, flipped, error, mean), noise = apart(true, ours), apart(one, two)
    print(
        f"| {mesh.stem} | {d.period:.3g} | {triangles:,} | {missed:.4f} / {noise[0]:.4f} | {flipped:.3f} / {noise[1]:.3f} | "
        f"{error:.3f} / {noise[2]:.3f} | {mean:+.1%} | {traced * 32 / asked.spp:.1f} | "
        f"{(report.seconds['wall'] - report.seconds['prepare']) * 16 / asked.samples:.1f} | {report.counts['queries']:,} |",
        flush=True,
    )
    asked.folder.mkdir(exist_ok=True)
    pair = np.concatenate([over(true), np.ones((asked.side, 6, 3)), over(ours)], axis=1)
    write_png(asked.folder / f"silhouettes_{Path(name).stem}_{mesh.stem}_{d.period:.3g}_{asked.filter}.png", pair)


def over(image: np.ndarray) -> np.ndarray:
    return np.maximum(image[..., :3], 0) + (1 - image[..., 3:]) * BEHIND


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", help="the mesostructure: a procedure's name, or an image file")
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--side", type=int, default=384, help="pixels along a picture's side")
    parser.add_argument("--spp", type=int, default=1024, help="paths a pixel of the geometry")
    parser.add_argument("--samples", type=int, default=256, help="rays a pixel of the material")
    parser.add_argument("--filter", choices=SETTINGS["curvature_filter"].words, default="curve")
    parser.add_argument("--folder", type=Path, default=Path("out"))
    parser.add_argument("--camera", type=float, nargs=7, default=None)
    asked = parser.parse_args()
    asked.camera = tuple(asked.camera) if asked.camera else None
    print("| mesh | period | triangles | 1 - IoU | FLIP | squared error | mean | geometry, s | material, s | queries |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for mesh, period in [(torus(Path(folder) / "torus.obj"), p) for p in PERIODS] + [(SPOT, None)]:
            compare(asked.name, asked.bundle, mesh, period, asked)


if __name__ == "__main__":
    main()
