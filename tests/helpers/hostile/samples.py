"""Small files of every kind that are well, made without JAX: what generated cases damage."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mesoshell.geometry.read_usd import pxr
from mesoshell.io.archive import write_arrays
from mesoshell.io.bundle_arrays import SHELL
from mesoshell.io.image import write_exr, write_png
from mesoshell.io.surface import MODULES

QUAD = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0.25
vt 0 0
vt 1 0
vt 1 1
vt 0 1
f 1/1 2/2 3/3
f 1/1 3/3 4/4
"""
EYE = np.eye(4).tolist()


def make(folder: Path) -> None:
    """All of them."""
    import trimesh
    from trimesh.exchange.gltf import export_gltf

    random = np.random.default_rng(0)
    (folder / "quad.obj").write_text(QUAD)
    ball = trimesh.creation.icosphere(0)
    uv = random.random((len(ball.vertices), 2))
    textured = trimesh.Trimesh(ball.vertices, ball.faces, visual=trimesh.visual.TextureVisuals(uv=uv), process=False)  # type: ignore[attr-defined]
    textured.export(folder / "ball.glb")
    parts = export_gltf(trimesh.Scene(textured), embed_buffers=True)
    (folder / "ball.gltf").write_bytes(next(data for name, data in parts.items() if name.endswith(".gltf")))
    ball.export(folder / "ball.off")
    ball.export(folder / "ball.stl")
    ball.export(folder / "ball.ply")
    ball.export(folder / "text.ply", encoding="ascii")
    textured.export(folder / "ball.dae")
    ball.export(folder / "ball.3mf")
    for kind, name in (("zae", "ball.dae"), ("zip", "ball.gltf")):
        with zipfile.ZipFile(folder / f"ball.{kind}", "w", zipfile.ZIP_DEFLATED) as archive:
            archive.write(folder / name, f"made/{name}")
    for kind in ("usda", "usdc"):
        stage(folder / f"ball.{kind}", ball.vertices, ball.faces, uv)
    pxr("UsdUtils").CreateNewUsdzPackage(str(folder / "ball.usdc"), str(folder / "ball.usdz"))
    write_exr(folder / "sky.exr", random.random((4, 8, 4), np.float32))
    write_exr(folder / "float.exr", random.random((4, 8, 3), np.float32), half=False)
    write_png(folder / "a.png", random.random((6, 5, 3), np.float32))
    Image.fromarray((random.random((6, 5, 3)) * 255).astype(np.uint8)).save(folder / "a.jpg")
    shell(folder / "shell.npz", shell_manifest(), shell_arrays(random))
    shell(folder / "surface.npz", surface_manifest(), surface_arrays(random))
    dataset(folder / "plain", False)
    dataset(folder / "packed", True)
    patches(folder / "queries")
    capture(folder / "capture", random)
    np.savez(folder / "cameras.npz", world_mat_0=np.diag([5.0, 5, 1, 1]), scale_mat_0=np.eye(4))


def stage(path: Path, points: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> None:
    """A USD stage of one mesh, under a transform."""
    Sdf, Usd, UsdGeom = pxr("Sdf"), pxr("Usd"), pxr("UsdGeom")
    made = Usd.Stage.CreateNew(str(path))
    UsdGeom.Xform.Define(made, "/World").AddTranslateOp().Set((1, 2, 3))
    mesh = UsdGeom.Mesh.Define(made, "/World/Ball")
    mesh.GetPointsAttr().Set(points.tolist())
    mesh.GetFaceVertexCountsAttr().Set([3] * len(faces))
    mesh.GetFaceVertexIndicesAttr().Set(faces.ravel().tolist())
    coordinates = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex")
    coordinates.Set(uv.tolist())
    made.Save()


def shell_manifest() -> dict[str, Any]:
    parameter = {"name": "age", "role": "alpha", "range": [0, 2], "default": 1, "unit": "1", "meaning": "how old"}
    said = {"schema": 2, "kind": "shell", "texel_density": 4, "channels": 2, "height_octaves": 1, "thickness": 1.0}
    said |= {"parameters": [parameter], "wraps": True, "generator": None, "twin": None, "provenance": {}}
    return said | {"colour_space": "linear Rec. 709"}


def shell_arrays(random: np.random.Generator) -> dict[str, np.ndarray]:
    """The arrays of `SHELL` by its own table of symbols."""
    sizes = {"C": 2, "T0": 6, "T1": 4, "T": 4, "S0": 10, "S1": 4, "S": 4, "1": 1, "3": 3, "any": 2, "L": 3, "B": 2}
    sizes |= {f"{letter}{i}": 4 >> i for letter in "HWR" for i in range(3)}
    arrays = {}
    for pattern, (symbols, _) in SHELL.items():
        if pattern.startswith("heights"):
            continue
        for i in range(3 if pattern.partition("/")[0] in ("features", "height", "grid") else 1):
            shape = [sizes[symbol.format(i=i, j=i + 1)] for symbol in symbols]
            arrays[pattern.format(i=i)] = random.random(shape).astype(np.float32)
    arrays["sigma_scale"] = np.asarray(10, np.float32)
    return arrays


def surface_manifest() -> dict[str, Any]:
    said = {
        "schema": 2,
        "kind": "silhouette",
        "texels": 2,
        "channels": 2,
        "opacity": "cosine",
        "step": 0.1,
        "offset": 0.1,
    }
    said |= {"sees_curvature": True, "curvature": [-1, 1], "depth": 0.2, "provenance": {}}
    return said | {"colour_space": "linear Rec. 709"}


def surface_arrays(random: np.random.Generator) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    for module, (seen, out) in MODULES.items():
        arrays |= {f"{module}/texture/{i}": random.random((2 >> i, 2 >> i, 2)).astype(np.float16) for i in range(2)}
        for name, rows, columns in (("hidden/0", 2 + seen, 3), ("last", 3, out)):
            arrays[f"{module}/{name}/kernel"] = random.random((rows, columns)).astype(np.float32)
            arrays[f"{module}/{name}/bias"] = random.random(columns).astype(np.float32)
    return arrays


def shell(path: Path, manifest: Any, arrays: dict[str, np.ndarray]) -> None:
    """A bundle with any manifest."""
    text = np.frombuffer(json.dumps(manifest).encode(), np.uint8)
    write_arrays(path, {"manifest.json": text, **arrays})


def dataset(folder: Path, packed: bool) -> None:
    """Three images of 6 × 4, of one parameter."""
    import hashlib

    random = np.random.default_rng(1)
    kept = folder / ("shards" if packed else "images")
    kept.mkdir(parents=True)
    images = random.random((3, 4, 6, 4)).astype(np.float16)
    manifest = {"schema": 1, "alpha": "premultiplied", "recipe": "grass", "version": 1, "field_of_view": 0.5, "seed": 0}
    age = {"role": "alpha", "range": [0, 1], "default": 0, "unit": "1", "meaning": "how old"}
    manifest |= {"parameters": {"age": age}, "radius_range": [1, 2], "size": [6, 4], "samples_per_pixel": 4, "count": 3}
    row = {"seed": 0, "size": [6, 4], "camera_to_world": EYE, "fov": 0.5, "radius": 2.0, "parameters": {"age": 0.5}}
    row |= {"light": [0, 0, 1], "irradiance": [1, 1, 1]}
    rows = []
    for i, image in enumerate(images):
        if packed:
            place = {"file": "shards/0000.npy", "row": i, "sha256": hashlib.sha256(image.tobytes()).hexdigest()}
        else:
            file = folder / f"images/{i:06d}.exr"
            write_exr(file, image)
            place = {"file": f"images/{i:06d}.exr", "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}
        rows.append(row | {"index": i} | place)
    if packed:
        np.save(folder / "shards/0000.npy", images)
        manifest |= {"packed": "half"}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    (folder / "samples.jsonl").write_text("".join(json.dumps(r) + "\n" for r in rows))


def patches(folder: Path) -> None:
    (folder / "patches").mkdir(parents=True)
    np.save(folder / "patches/000000.npy", np.random.default_rng(2).random((5, 16)).astype(np.float32))
    (folder / "manifest.json").write_text(json.dumps({"kind": "patches", "source": "weave", "count": 1}))
    (folder / "samples.jsonl").write_text(json.dumps({"index": 0, "file": "patches/000000.npy"}) + "\n")


def capture(folder: Path, random: np.random.Generator) -> None:
    """Two photographs with transforms.json, and the same as a COLMAP model."""
    (folder / "images").mkdir(parents=True)
    (folder / "sparse/0").mkdir(parents=True)
    frames = []
    for i in range(2):
        write_png(folder / f"images/{i}.png", random.random((6, 6, 4), np.float32))
        turn = np.diag([1.0, 1, 1, 1]) if i == 0 else np.diag([-1.0, 1, -1, 1])
        turn[:3, 3] = 3 * turn[:3, 2]
        frames.append({"file_path": f"images/{i}.png", "transform_matrix": turn.tolist(), "fl_x": 9, "w": 6, "h": 6})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    model = folder / "sparse/0"
    (model / "cameras.txt").write_text("1 PINHOLE 6 6 9 9 3 3\n")
    (model / "images.txt").write_text("1 1 0 0 0 0 0 3 1 0.png\n\n2 0 1 0 0 0 0 3 1 1.png\n\n")
    (model / "points3D.txt").write_text("")
