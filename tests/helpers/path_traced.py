"""Small scenes for the path tracer: materials, shells, a sensor, a quality."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from mesoshell.geometry.mesh import Mesh, check_mesh
from mesoshell.io.bundle import Bundle
from mesoshell.pathtracer.load import load_dict
from mesoshell.render.quality import PRESETS, Quality

ROOT = Path(__file__).parents[2]
AGE = 0.3
#: Of the pictures, in pixels.
SIZE = 12
QUALITY = PRESETS["normal"].with_changes(
    pixel_samples=1, samples=20, early_stop=0.0, spacing="length", light_samples=0, density="network", anisotropy=1
)
#: ∫ of the fade of ρ below the horizon and 1 above it, over the sphere.
WHOLE = 2 * np.pi * 1.05


def box() -> Mesh:
    """A square of two triangles: its shell is the flat unit box."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return check_mesh(corners, faces, corners[faces][..., :2], "box")


def rough(bundle: Bundle) -> Bundle:
    """The untrained material with weights that make its σ and ρ vary as much as a trained one's."""
    scaled = {k: np.float32(3) * v if k.endswith("kernel") else v for k, v in bundle.arrays.items()}
    return replace(bundle, arrays=scaled | {"sigma_scale": np.array(400, np.float32)})


def surface(mesh: Mesh) -> mi.Scene:
    """The mesh as a scene of Mitsuba's."""
    made = mi.Mesh("surface", len(mesh.vertices), len(mesh.faces))
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = mi.Float(mesh.vertices.ravel())
    parameters["faces"] = mi.UInt32(mesh.faces.ravel().astype(np.uint32))
    parameters.update()
    return mi.load_dict({"type": "scene", "surface": made})


def constant(bundle: Bundle, sigma: float, rho: float) -> Bundle:
    """A material of one σ and one ρ."""
    arrays = {k: np.zeros_like(v) if k.startswith("decoder/") else v for k, v in bundle.arrays.items()}
    arrays["sigma_scale"] = np.array(sigma / np.log1p(np.exp(-3.0)), np.float32)
    arrays["decoder/rho/bias"] = np.full(3, 2 + np.log(np.expm1(rho)), np.float32)
    arrays |= {k: np.full_like(v, 2 * sigma) for k, v in arrays.items() if k.startswith("grid/")}
    return replace(bundle, arrays=arrays)


def sensor(**more) -> dict:
    view = mi.ScalarTransform4f().look_at([0.5, -1.6, 2.4], [0.5, 0.5, 0.4], [0, 0, 1])
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgba"}
    return {"type": "perspective", "fov": 30, "to_world": view, "film": film} | more


def shell(materials: Path, name: str, **more) -> dict:
    """The unit square with a shell of height 1 on black ground."""
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    asked = {"material": str(materials / f"{name}.npz"), "thickness": 1.0, "scale": 1.0, **more.pop("asked", {})}
    bsdf = {"type": "mesoshell", "inner": black, **asked}
    return {"type": "obj", "filename": str(materials / "box.obj"), "bsdf": bsdf} | more


def scene(*shapes: dict, light: dict | None = None, depth: int = 2, eye: dict | None = None) -> dict:
    light = light or {"type": "directional", "direction": [-0.3, 0.2, -1.0], "irradiance": 3.0}
    parts = {f"shape{i}": shape for i, shape in enumerate(shapes)}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": depth},
        "sensor": eye or sensor(),
        "light": light,
        **parts,
    }


def loaded(parts: dict, quality: Quality = QUALITY) -> Any:
    return load_dict(parts, quality)


def placed(materials: Path, name: str, matrix: np.ndarray, asked: dict | None = None) -> tuple[dict, dict]:
    """A shape group with a shell, and an instance of it."""
    square = shell(materials, name, asked=asked or {})
    group = {"type": "shapegroup", "square": square}
    return group, {
        "type": "instance",
        "group": {"type": "ref", "id": "shape0"},
        "to_world": mi.ScalarTransform4f(matrix),
    }
