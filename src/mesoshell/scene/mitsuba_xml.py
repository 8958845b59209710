"""Write a scene as a folder: scene.xml of Mitsuba's, and beside it meshes, images and the material (no JAX, no Mitsuba).

Meshes are OBJ files with the texture coordinates that the shell grows by; images are OpenEXR in float32, and those over the UV
square begin at v = 0, as Mitsuba's do. A bundled material stays a name, the folder of a large texture where it is; a file is
copied.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from mesoshell.errors import Argument, InputError
from mesoshell.geometry.mesh import Mesh
from mesoshell.io.archive import MANIFEST
from mesoshell.io.atomic import new_folder, read_file
from mesoshell.io.image import write_exr
from mesoshell.io.material import bundled_materials
from mesoshell.io.surface import KIND
from mesoshell.render.camera import Camera
from mesoshell.render.lamp import EXTENDED, Lamp, facing, radius
from mesoshell.render.light import Distant
from mesoshell.render.mitsuba_frame import camera_pose, fitting_grid, near_clip, sky_pose, spot_angles
from mesoshell.render.quality import Quality
from mesoshell.scene.growth import grows, latent_of
from mesoshell.scene.scene import Grown, Scene
from mesoshell.scene.settle import settle
from mesoshell.scene.setup import check_shell, describe_shell, describe_surface

#: The file of the scene in its folder.
NAME = "scene.xml"
_HIDDEN = ' <boolean name="hide_lamps" value="true"/>'


def write_folder(scene: Scene, folder: Path, quality: Quality) -> tuple[Path, tuple[str, ...]]:
    """Write it, with the quality's paths and depths; the path of scene.xml, and what the user should know. Raises InputError,
    also if the folder exists."""
    if os.path.lexists(folder):
        raise InputError(folder, "exists already")
    if scene.holdout:
        raise InputError(Argument("holdout"), "a scene of Mitsuba's holds no objects out")
    if any(part.growth is not None for part in (scene, *scene.also)):
        raise InputError(Argument("growth"), "a scene of Mitsuba's has one thickness a mesh")
    still = settle(scene, texture=False)
    if any(part.material.kind != KIND and latent_of(part) is not None for part in (still, *still.also)):
        fault = "a scene of Mitsuba's has none: make a texture (mesoshell texture), and give it as the material"
        raise InputError(Argument("latent"), fault)
    assert isinstance(still.mesh, Mesh)
    if scene.material.kind == KIND:
        describe_surface(scene)  # raises what a picture of it would
        notes = still.mesh.notes
    elif any(grows(part) for part in (still, *still.also)):
        notes = check_shell(still)
    else:
        notes = describe_shell(still).notes
    with new_folder(folder) as made:
        text = "\n".join(_lines(still, made, quality))
        (made / NAME).write_text(f'<scene version="3.0.0">\n{text}\n</scene>\n', encoding="utf-8")
    return folder / NAME, notes


def _lines(still: Scene, folder: Path, quality: Quality) -> Iterator[str]:
    assert isinstance(still.camera, Camera) and isinstance(still.mesh, Mesh)
    hides = any(lamp.kind in EXTENDED for lamp in still.lamps)
    yield f'''    <integrator type="{"mesoshell_path" if hides else "path"}">
        <integer name="max_depth" value="{quality.max_depth}"/> <integer name="rr_depth" value="{quality.rr_depth}"/>
        <boolean name="hide_emitters" value="{str(still.transparent).lower()}"/>{_HIDDEN if hides else ""}
    </integrator>'''
    fits = fitting_grid(quality.spp) == quality.spp
    sampler = "multijitter" if fits else "independent"
    yield f'''    <sensor type="perspective">
        <float name="fov" value="{np.degrees(still.camera.fov):.17g}"/> <string name="fov_axis" value="y"/>
        <float name="near_clip" value="{near_clip(still.mesh)!r}"/> <float name="far_clip" value="1e6"/>
        <transform name="to_world"> {_matrix(camera_pose(still.camera))} </transform>
        <film type="hdrfilm">
            <integer name="width" value="{still.camera.width}"/> <integer name="height" value="{still.camera.height}"/>
            <rfilter type="box"/> <string name="pixel_format" value="rgba"/>
        </film>
        <sampler type="{sampler}"> <integer name="sample_count" value="{quality.spp}"/> </sampler>
    </sensor>'''
    for light in still.lights:
        assert isinstance(light, Distant)
        yield f'''    <emitter type="directional">
        <vector name="direction" value="{_numbers(-light.direction)}"/>
        <rgb name="irradiance" value="{_numbers(light.irradiance)}"/>
    </emitter>'''
    yield from map(_lamp, still.lamps)
    if still.environment is not None:
        write_exr(folder / "sky.exr", np.asarray(still.environment, np.float32), half=False)
        yield f"""    <emitter type="envmap">
        <string name="filename" value="sky.exr"/>
        <transform name="to_world"> {_matrix(sky_pose(1 if still.up == "y" else 2))} </transform>
    </emitter>"""
    ground = _diffuse(still.base_colour)
    for k, part in enumerate((still, *still.also)):
        assert isinstance(part.mesh, Mesh)
        number = str(k or "")
        yield _shape(part.mesh, folder / f"mesh{number}.obj", "\n".join(_shell(part, folder, ground, number)))
    for k, mesh in enumerate(still.objects):
        assert isinstance(mesh, Mesh)
        bsdf = _diffuse(mesh.colour or still.base_colour)
        if mesh.texture is not None:
            write_exr(folder / f"albedo{k}.exr", mesh.texture.image[::-1], half=False)
            bsdf = _textured(f"albedo{k}.exr")
        yield _shape(mesh, folder / f"object{k}.obj", f"        {bsdf}")


def _diffuse(colour: tuple[float, float, float]) -> str:
    return _twosided(f'<rgb name="reflectance" value="{_numbers(colour)}"/>')


def _textured(file: str) -> str:
    inside = f'<string name="filename" value="{file}"/> <boolean name="raw" value="true"/>'
    return _twosided(f'<texture type="bitmap" name="reflectance"> {inside} </texture>')


def _twosided(albedo: str) -> str:
    return f'<bsdf type="twosided"> <bsdf type="diffuse"> {albedo} </bsdf> </bsdf>'


def _lamp(lamp: Lamp) -> str:
    strength, at = _numbers(lamp.strength), _numbers(lamp.pose[:3, 3])
    if lamp.kind not in EXTENDED:
        parts = [f'<rgb name="intensity" value="{strength}"/>']
    else:
        radiance = f'<rgb name="radiance" value="{strength}"/>'
        black = '<bsdf type="diffuse"> <rgb name="reflectance" value="0"/> </bsdf>'
        parts = [f'<emitter type="area"> {radiance} </emitter>', black]
    if lamp.kind == "point":
        parts.append(f'<point name="position" value="{at}"/>')
    elif lamp.kind == "sphere":
        parts += [f'<point name="center" value="{at}"/>', f'<float name="radius" value="{radius(lamp)!r}"/>']
    else:
        parts.append(f'<transform name="to_world"> {_matrix(facing(lamp))} </transform>')
    if lamp.kind == "spot":
        names = ("beam_width", "cutoff_angle")
        parts += [f'<float name="{k}" value="{x!r}"/>' for k, x in zip(names, spot_angles(lamp), strict=True)]
    element = "shape" if lamp.kind in EXTENDED else "emitter"
    lines = "\n".join(f"        {part}" for part in parts)
    return f'    <{element} type="{lamp.kind}">\n{lines}\n    </{element}>'


def _shell(still: Scene | Grown, folder: Path, ground: str, number: str) -> Iterator[str]:
    """The mesh's BSDF. number: in the names of its files."""
    yield f"""        <bsdf type="mesoshell">
            <string name="material" value={_quoted(_material(still.material.name, folder, number))}/>"""
    for name, value in (("thickness", still.thickness), ("scale", still.scale)):
        if value is not None:
            yield f'            <float name="{name}" value="{float(value)!r}"/>'
    if still.seed is not None:
        yield f'            <integer name="seed" value="{still.seed}"/>'
    for k, (name, value) in enumerate(still.params.items()):
        if isinstance(value, np.ndarray):
            image = np.repeat(value[::-1, :, None].astype(np.float32), 3, axis=2)
            file = f"param{k}.exr" if not number else f"param{number}_{k}.exr"
            write_exr(folder / file, image, half=False)
            yield f"""            <texture type="bitmap" name={_quoted(name)}>
                <string name="filename" value="{file}"/> <boolean name="raw" value="true"/>
                <string name="filter_type" value="nearest"/> <string name="wrap_mode" value="repeat"/>
            </texture>"""
        else:
            yield f'            <float name={_quoted(name)} value="{float(value)!r}"/>'  # type: ignore[arg-type]
    yield f"            {ground}"
    yield "        </bsdf>"


def _material(name: str, folder: Path, number: str) -> str:
    """How the scene calls a material. Raises InputError for one that is in no file."""
    if name in bundled_materials():
        return name
    path = Path(name)
    if (path / MANIFEST).is_file():
        return str(path.resolve())
    if not path.is_file():
        raise InputError(name, "is a material in no file: write its bundle, and load that")
    (folder / f"material{number}.npz").write_bytes(read_file(path))
    return f"material{number}.npz"


def _quoted(text: str) -> str:
    """An attribute's value. Raises InputError for one that Mitsuba takes for a parameter's."""
    if "$" in text:
        raise InputError(text, "holds a $, which Mitsuba replaces")
    return quoteattr(text)


def _shape(mesh: Mesh, path: Path, bsdf: str) -> str:
    """A mesh, written to a path, with its BSDF."""
    corners = 1 + np.arange(3 * len(mesh.faces)).reshape(-1, 3)
    corner = lambda v, t: f"{v}/{t}"  # noqa: E731
    rows = [
        *(f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices),
        *(f"vt {u:.9g} {v:.9g}" for u, v in mesh.uv.reshape(-1, 2)),
        *("f " + " ".join(map(corner, face, at)) for face, at in zip(mesh.faces + 1, corners, strict=True)),
    ]
    path.write_text("\n".join(rows) + "\n", encoding="ascii")
    return f'''    <shape type="obj">
        <string name="filename" value="{path.name}"/>
        <boolean name="face_normals" value="true"/> <boolean name="flip_tex_coords" value="false"/>
{bsdf}
    </shape>'''


def _numbers(values) -> str:
    return ", ".join(repr(float(x)) for x in values)


def _matrix(pose: np.ndarray) -> str:
    return f'<matrix value="{" ".join(f"{x:.17g}" for x in pose.ravel())}"/>'
