"""What a USD stage says beside its meshes: its camera, its distant lights, and which axis is up (no JAX).

Notation
E           irradiance of a distant light on a plane facing it: intensity · 2^exposure · colour, where it is normalised; else
            that times π sin² of half its angle

Sources: OpenUSD's documentation of UsdGeomCamera and UsdLuxDistantLight. Blender writes a quarter of a sun's strength, and
reads four times what is written: so does this, for stages that say they are Blender's.
"""

from os import PathLike
from typing import Any

import numpy as np

from mesoshell.geometry.read_usd import is_visible, matrix, opened, pxr
from mesoshell.render.light import Distant
from mesoshell.scene.told import Told, frame_of, sun_of

#: As above; the temperature of white light, kelvin, by default.
BLENDERS, WHITE = 4.0, 6500.0


def told_by(path: str | PathLike[str]) -> Told:
    """What a stage says. Raises InputError, or ValueError if it is damaged there."""
    with opened(path) as (stage, time):
        Usd, UsdGeom, UsdLux = pxr("Usd"), pxr("UsdGeom"), pxr("UsdLux")

        frames, cameras, suns, others = UsdGeom.XformCache(time), [], [], []
        share = BLENDERS if stage.GetRootLayer().documentation.startswith("Blender") else 1.0
        for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
            to_world = matrix(frames.GetLocalToWorldTransform(prim)) if prim.IsA(UsdGeom.Xformable) else np.eye(4)
            if prim.IsA(UsdGeom.Camera):
                cameras.append((prim, to_world))
            elif prim.HasAPI(UsdLux.LightAPI) and is_visible(prim, time):
                if prim.IsA(UsdLux.DistantLight):
                    suns.append(_sun(UsdLux.DistantLight(prim), to_world, share, time))
                else:
                    others.append(prim.GetName())
        camera, aspect, notes = _camera(cameras, time)
        if others:
            notes.append(f"its lights that are not distant are left out: {', '.join(others)}")
        up = "z" if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else "y"
        return Told(camera, aspect, tuple(suns), tuple(notes), up)


def _camera(cameras: list, time: Any) -> tuple[Any, float | None, list[str]]:
    """Frame and field of view of the first perspective camera, its aspect, and notes."""
    Gf, UsdGeom = pxr("Gf"), pxr("UsdGeom")

    notes, seen = [], []
    for prim, to_world in cameras:
        lens = UsdGeom.Camera(prim).GetCamera(time)
        if lens.projection != Gf.Camera.Perspective:
            notes.append(f"its camera {prim.GetName()} is no perspective one: left out")
            continue
        fov, aspect = np.radians(lens.GetFieldOfView(Gf.Camera.FOVVertical)), lens.aspectRatio
        if not 0 < fov < np.pi or not 1e-3 < aspect < 1e3:
            raise ValueError(f"{prim.GetPath()} sees {fov:g} radians, {aspect:g} times as wide as high")
        seen.append((prim.GetName(), (frame_of(to_world), float(fov)), float(aspect)))
    if not seen:
        return None, None, notes
    if len(seen) > 1:
        notes.append(f"it has {len(seen)} cameras: {seen[0][0]}, the first, is taken")
    return seen[0][1], seen[0][2], notes


def _sun(light: Any, to_world: np.ndarray, share: float, time: Any) -> Distant:
    UsdLux = pxr("UsdLux")

    colour = np.array(light.GetColorAttr().Get(time), np.float64)
    if light.GetEnableColorTemperatureAttr().Get(time):
        kelvin = light.GetColorTemperatureAttr().Get(time), WHITE
        own, white = (np.array(UsdLux.BlackbodyTemperatureAsRgb(k), np.float64) for k in kelvin)
        colour = colour * own / white
    strength = share * light.GetIntensityAttr().Get(time) * 2.0 ** light.GetExposureAttr().Get(time)
    if not light.GetNormalizeAttr().Get(time):
        strength *= np.pi * np.sin(np.radians(light.GetAngleAttr().Get(time)) / 2) ** 2
    return sun_of(to_world, colour * strength)
