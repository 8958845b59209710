"""Parts of Mitsuba scenes from a described scene: meshes, a pinhole camera, distant lights, lamps, a sky.

Surfaces are diffuse. Images over the UV square have v = 1 in their first row; Mitsuba's bitmaps have v = 0 there.
"""

from typing import Any

import mitsuba as mi
import numpy as np
from jaxtyping import Float

from mesoshell.geometry.mesh import Mesh
from mesoshell.render.camera import Camera
from mesoshell.render.lamp import EXTENDED, Lamp, facing, radius
from mesoshell.render.light import Distant, Environment
from mesoshell.render.mitsuba_frame import camera_pose, sky_pose, spot_angles


def sensor(camera: Camera, samples: int, near: float = 1e-4) -> dict:
    """A camera, as a dictionary that `mi.load_dict` takes. samples: paths a pixel; near: what is nearer is not seen."""
    film = {"type": "hdrfilm", "width": camera.width, "height": camera.height, "rfilter": {"type": "box"}}
    pose: Any = camera_pose(camera)
    film["pixel_format"] = "rgba"
    return {
        "type": "perspective",
        "fov": float(np.degrees(camera.fov)),
        "fov_axis": "y",
        "to_world": mi.ScalarTransform4f(pose),
        "near_clip": near,
        "far_clip": 1e6,
        "film": film,
        "sampler": {"type": "multijitter", "sample_count": samples},
    }


def distant(light: Distant) -> dict:
    """A distant light, as a dictionary that `mi.load_dict` takes."""
    toward = [float(-x) for x in light.direction]
    return {"type": "directional", "direction": toward, "irradiance": _rgb(light.irradiance)}


def lamp(given: Lamp) -> dict:
    """A lamp, as a dictionary that `mi.load_dict` takes. What has an extent is black."""
    made: dict[str, Any] = {"type": given.kind}
    if given.kind in EXTENDED:
        black = {"type": "diffuse", "reflectance": _rgb((0, 0, 0))}
        made |= {"emitter": {"type": "area", "radiance": _rgb(given.strength)}, "bsdf": black}
    else:
        made["intensity"] = _rgb(given.strength)
    position = [float(x) for x in given.pose[:3, 3]]
    if given.kind == "point":
        return made | {"position": position}
    if given.kind == "sphere":
        return made | {"center": position, "radius": radius(given)}
    pose: Any = facing(given)
    if given.kind == "spot":
        made |= dict(zip(("beam_width", "cutoff_angle"), spot_angles(given), strict=True))
    return made | {"to_world": mi.ScalarTransform4f(pose)}


def sky(environment: Environment) -> dict:
    """An environment, as a dictionary that `mi.load_dict` takes."""
    image = np.ascontiguousarray(environment.radiance)
    pose: Any = sky_pose(environment.up)
    return {"type": "envmap", "bitmap": mi.Bitmap(image), "to_world": mi.ScalarTransform4f(pose)}


def surface(mesh: Mesh, albedo: tuple[float, float, float]) -> mi.Mesh:
    """A mesh with flat faces and a vertex for each corner, diffuse from both sides. albedo: unless it has a texture."""
    props = mi.Properties()
    reflectance: Any = _rgb(albedo)
    if mesh.texture is not None:
        bitmap = mi.Bitmap(np.ascontiguousarray(mesh.texture.image[::-1]))
        reflectance = {"type": "bitmap", "bitmap": bitmap, "wrap_mode": "repeat", "raw": True}
    props["bsdf"] = mi.load_dict({"type": "twosided", "inner": {"type": "diffuse", "reflectance": reflectance}})
    count = 3 * len(mesh.faces)
    made = mi.Mesh("surface", count, len(mesh.faces), props=props, has_vertex_texcoords=True)
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = mi.Float(mesh.vertices[mesh.faces].astype(np.float32).ravel())
    parameters["vertex_texcoords"] = mi.Float(mesh.uv.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(np.arange(count, dtype=np.uint32))
    parameters.update()
    return made


def over_uv(image: Float[np.ndarray, "H W"]) -> mi.Texture:
    """An image over the UV square, repeated, without conversion."""
    bitmap = mi.Bitmap(np.ascontiguousarray(image[::-1, :, None], np.float32))
    return mi.load_dict(
        {"type": "bitmap", "bitmap": bitmap, "filter_type": "nearest", "wrap_mode": "repeat", "raw": True}
    )


def _rgb(values) -> dict:
    return {"type": "rgb", "value": [float(x) for x in values]}
