"""What a USD stage says beside its meshes: its camera, its lights, and which axis is up (no JAX).

Notation
E           irradiance of a distant light on a plane facing it: intensity · 2^exposure · colour, where it is normalised; else
            that times its size: 1 for no angle, π sin² θ for half an angle θ up to 90°, π (2 − sin² θ) beyond
L           radiance of a dome light: intensity · 2^exposure · colour, times its image (scene/dome); of a sphere, a rectangle
            or a disk, which are lamps (render/lamp): without an image, and over its area where it is normalised

Colours of temperature are relative to 6500 K, which is white. Blender writes a quarter of a sun's strength, and reads four
times what is written: so does this, for stages that say they are Blender's.

Sources: OpenUSD's documentation of UsdGeomCamera, UsdLuxDistantLight and UsdLuxLightAPI.
"""

from os import PathLike
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.geometry.read_usd import is_visible, matrix, open_stage, prims, pxr
from mesoshell.render.lamp import Kind, Lamp, area, radius
from mesoshell.render.light import Distant
from mesoshell.scene.dome import dome_of
from mesoshell.scene.file_scene import FileScene, frame_of, lamp_fault, sun_of

#: Lamps, by their schemas.
LAMPS: dict[str, Kind] = {"SphereLight": "sphere", "RectLight": "rectangle", "DiskLight": "disk"}
#: What a sun of Blender's is of its strength in the stage; the temperature of white light, kelvin, by default.
SUN, WHITE = 4.0, 6500.0


def read_file_scene(path: str | PathLike[str]) -> FileScene:
    """What a stage says. Raises InputError, or ValueError if it is damaged there."""
    with open_stage(path) as (stage, time):
        UsdGeom, UsdLux, UsdSkel = pxr("UsdGeom"), pxr("UsdLux"), pxr("UsdSkel")
        frames, cameras, suns, lights, shapes, notes = UsdGeom.XformCache(time), [], [], [], [], []
        blenders = stage.GetRootLayer().documentation.startswith("Blender")
        skeletons, domes, lamps, images, shaped = 0, [], [], [], []
        up = "z" if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else "y"
        for prim in prims(stage.GetPseudoRoot()):
            skeletons += prim.IsA(UsdSkel.Root)
            to_world = matrix(frames.GetLocalToWorldTransform(prim)) if prim.IsA(UsdGeom.Xformable) else np.eye(4)
            if prim.IsA(UsdGeom.Camera):
                cameras.append((prim, to_world))
            elif prim.HasAPI(UsdLux.LightAPI) and is_visible(prim, time):
                if prim.IsA(UsdLux.DomeLight) or prim.IsA(UsdLux.DomeLight_1):
                    domes.append((prim, to_world))
                elif np.linalg.det(to_world[:3, :3]) == 0:
                    pass  # hidden by its scale
                elif (kind := next((k for k in LAMPS if prim.IsA(getattr(UsdLux, k))), None)) is not None:
                    lamp = _lamp(kind, prim, to_world, time)
                    fault = "" if lamp is None else lamp_fault(lamp)
                    lamps += [] if lamp is None or fault else [lamp]
                    notes += [f"its lamp {prim.GetName()} is left out: {fault}"] if fault else []
                    images += [prim.GetName()] if _has_image(prim, time) else []
                    shaped += [prim.GetName()] if _is_shaped(prim, kind) else []
                elif not prim.IsA(UsdLux.DistantLight):
                    lights.append(prim.GetName())
                else:
                    suns.append(_sun(UsdLux.DistantLight(prim), to_world, SUN if blenders else 1.0, time))
            elif prim.IsA(UsdGeom.Gprim) and not prim.IsA(UsdGeom.Mesh) and is_visible(prim, time):
                shapes.append(prim.GetName())
        camera, aspect, more = _camera(cameras, time)
        sky = None
        if domes:
            (prim, to_world), *others = domes
            light = (UsdLux.DomeLight if prim.IsA(UsdLux.DomeLight) else UsdLux.DomeLight_1)(prim)
            try:
                sky = dome_of(light, to_world, _strength(light, time), blenders, up, time)
            except ValueError as fault:
                notes.append(f"its sky is left out: {fault}")
            lights += [other.GetName() for other, _ in others]
        left_out = (
            ("lights of other kinds", lights),
            ("images of lamps", images),
            ("shapes of lamps' beams", shaped),
            ("shapes that are no meshes", shapes),
        )
        notes += [f"its {what} are left out: {_some(names)}" for what, names in left_out if names]
        if skeletons:
            notes.append("its skeletons move nothing: meshes stand as they were modelled")
        if missing := stage.GetCompositionErrors():
            notes.append(f"{len(missing)} of its layers or references cannot be read: {str(missing[0])[:200]}")
        return FileScene(camera, aspect, tuple(suns), (*more, *notes), up, sky, tuple(lamps))


def _some(names: list[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _camera(cameras: list, time: Any) -> tuple[Any, float | None, list[str]]:
    """Frame and field of view of the first perspective camera, its aspect, and notes. Raises ValueError."""
    Gf, UsdGeom = pxr("Gf"), pxr("UsdGeom")
    notes, seen = [], []
    for prim, to_world in cameras:
        if UsdGeom.Camera(prim).GetProjectionAttr().Get(time) in (None, UsdGeom.Tokens.perspective):
            seen.append((prim, to_world))
        else:
            notes.append(f"its camera {prim.GetName()} is no perspective one: left out")
    if not seen:
        return None, None, notes
    prim, to_world = seen[0]
    if len(seen) > 1:
        notes.append(f"it has {len(seen)} cameras: {prim.GetName()}, the first, is taken")
    lens = UsdGeom.Camera(prim).GetCamera(time)
    fov, aspect = float(np.radians(lens.GetFieldOfView(Gf.Camera.FOVVertical))), float(lens.aspectRatio)
    if not 0 < fov < np.pi or not 1e-3 < aspect < 1e3:
        raise ValueError(f"{prim.GetPath()} sees {fov:g} radians, {aspect:g} times as wide as high")
    if lens.horizontalApertureOffset or lens.verticalApertureOffset:
        notes.append(f"the shift of its camera {prim.GetName()} is left out")
    return (frame_of(to_world), fov), aspect, notes


def _sun(light: Any, to_world: np.ndarray, share: float, time: Any) -> Distant:
    strength = share * _strength(light, time)
    if not light.GetNormalizeAttr().Get(time):
        strength *= _size(np.radians(np.clip(light.GetAngleAttr().Get(time) / 2, 0, 180)))
    return sun_of(to_world, strength)


def _lamp(kind: str, prim: Any, to_world: np.ndarray, time: Any) -> Lamp | None:
    """A lamp of one of LAMPS; None if it gives no light."""
    UsdLux = pxr("UsdLux")
    light = getattr(UsdLux, kind)(prim)
    strength, pose = _strength(light, time), to_world.copy()
    if kind == "RectLight":
        sides = light.GetWidthAttr().Get(time) / 2, light.GetHeightAttr().Get(time) / 2
    else:
        sides = light.GetRadiusAttr().Get(time), light.GetRadiusAttr().Get(time)
    normalised = light.GetNormalizeAttr().Get(time)
    point = kind == "SphereLight" and (light.GetTreatAsPointAttr().Get(time) or sides[0] == 0)
    if point and sides[0] == 0 and normalised:  # the limit of ever smaller spheres: L π r² over 4 π r²
        lamp = Lamp("point", pose, strength / 4)
    elif min(sides) <= 0:
        return None
    else:
        pose[:3, :3] *= (*sides, sides[0])
        lamp = Lamp(LAMPS[kind], pose, strength)
        if normalised:
            lamp = lamp._replace(
                strength=strength / (4 * np.pi * radius(lamp) ** 2 if kind == "SphereLight" else area(lamp))
            )
        if point:
            lamp = _as_point(lamp)
    if kind == "SphereLight" and prim.HasAPI(UsdLux.ShapingAPI):
        shaping = UsdLux.ShapingAPI(prim)
        ends = np.radians(shaping.GetShapingConeAngleAttr().Get(time))
        if shaping.GetShapingConeAngleAttr().HasAuthoredValue() and ends < np.pi:
            begins = ends * (1 - np.clip(shaping.GetShapingConeSoftnessAttr().Get(time), 0, 1))
            lamp = _as_point(lamp)._replace(kind="spot", pose=to_world, cone=(float(begins), float(ends)))
    return lamp if strength.any() else None


def _as_point(lamp: Lamp) -> Lamp:
    """A sphere, from far away."""
    if lamp.kind == "point":
        return lamp
    return Lamp("point", lamp.pose, lamp.strength * np.pi * radius(lamp) ** 2)


def _has_image(prim: Any, time: Any) -> bool:
    attribute = prim.GetAttribute("inputs:texture:file")
    value = attribute.Get(time) if attribute else None
    return value is not None and bool(value.path)


def _is_shaped(prim: Any, kind: str) -> bool:
    """Whether its beam has a shape that is not read."""
    if not prim.HasAPI(pxr("UsdLux").ShapingAPI):
        return False
    shaping = pxr("UsdLux").ShapingAPI(prim)
    left = [shaping.GetShapingFocusAttr(), shaping.GetShapingIesFileAttr()]
    left += [] if kind == "SphereLight" else [shaping.GetShapingConeAngleAttr()]
    return any(attribute.HasAuthoredValue() for attribute in left)


def _strength(light: Any, time: Any) -> Float[np.ndarray, "3"]:
    """Intensity · 2^exposure · colour."""
    colour = np.array(light.GetColorAttr().Get(time), np.float64)
    if light.GetEnableColorTemperatureAttr().Get(time):
        kelvin = light.GetColorTemperatureAttr().Get(time)
        if not np.isfinite(kelvin):  # which ends OpenUSD, and the program with it
            raise ValueError(f"{light.GetPath()} has a temperature of {kelvin} kelvin")
        own, white = (np.array(pxr("UsdLux").BlackbodyTemperatureAsRgb(k), np.float64) for k in (kelvin, WHITE))
        colour = colour * own / white
    return colour * light.GetIntensityAttr().Get(time) * 2.0 ** light.GetExposureAttr().Get(time)


def _size(theta: float) -> float:
    sine = np.sin(theta) ** 2
    return 1.0 if theta == 0 else np.pi * (sine if theta <= np.pi / 2 else 2 - sine)
