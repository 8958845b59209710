"""Entry point of another kind: photographs of a mesh from given cameras, one line out for each, then the end.

    python -m data_gen.photographer settings.json

Notation
    settings  mesh, frames ([{"file": …, "camera_to_world": …}, …]), fov, size, samples_per_pixel, paint, flash, sun, threads
    mesh      arrays `vertices` (V, 3), `faces` (T, 3), `uv` (T, 3, 2)
    flash     light from the camera alone: a point there, dark around; else a grey sky, and a sun from direction `sun`
    intensity of the flash: E⊥ at distance r is intensity / r², on each channel

Images are as the worker's.  The object is smooth and a little glossy; it is painted with an image, or cream with brown patches.
"""

import json
import math
import os
import sys
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np

from data_gen.nodes import Nodes
from data_gen.studio import black_world, set_cycles, set_output

SKY, SUN = 0.55, 2.2
#: Blender's watts of a point light, over its E⊥ at distance 1 (measured: see the README).
WATTS = 4 * math.pi


def main() -> int:
    out = os.fdopen(os.dup(1), "w", buffering=1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)  # Blender writes to descriptor 1 from C, past sys.stdout
    settings = json.loads(Path(sys.argv[1]).read_text())
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = black_world()
    set_output(scene.render, settings["size"], settings["threads"])
    set_cycles(scene)
    scene.cycles.samples, scene.cycles.use_denoising = settings["samples_per_pixel"], False
    made = add("object", mesh_of(np.load(settings["mesh"])))
    made.data.materials.append(material(settings["paint"]))
    camera = add("camera", bpy.data.cameras.new("camera"))
    camera.data.angle = settings["fov"]
    camera.data.clip_start, camera.data.clip_end = 1e-4, 1e6
    scene.camera = camera
    lamp = light(scene, settings["flash"], settings["sun"])
    for i, frame in enumerate(settings["frames"]):
        camera.matrix_world = mathutils.Matrix(frame["camera_to_world"])
        if settings["flash"] is not None:
            lamp.matrix_world = camera.matrix_world
        scene.cycles.seed = i
        scene.render.filepath = frame["file"]
        bpy.ops.render.render(write_still=True)
        out.write(json.dumps({"index": i}) + "\n")
    return 0


def add(name: str, data: Any) -> Any:
    made = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(made)
    return made


def mesh_of(arrays: Any) -> Any:
    mesh = bpy.data.meshes.new("object")
    mesh.from_pydata(arrays["vertices"].tolist(), [], arrays["faces"].tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), bool))
    mesh.uv_layers.new(name="uv").data.foreach_set("uv", arrays["uv"].ravel().astype(np.float32))
    mesh.update()
    return mesh


def light(scene: Any, flash: float | None, toward: list[float]) -> Any:
    if flash is not None:
        lamp = add("flash", bpy.data.lights.new("flash", "POINT"))
        lamp.data.energy, lamp.data.shadow_soft_size = flash * WATTS, 0.0
        return lamp
    sky = Nodes(scene.world.node_tree)
    background = sky.add("ShaderNodeBackground", Color=(SKY, SKY, SKY, 1.0), Strength=1.0)
    sky.put(sky.add("ShaderNodeOutputWorld").inputs["Surface"], background.outputs["Background"])
    lamp = add("sun", bpy.data.lights.new("sun", "SUN"))
    lamp.data.energy, lamp.data.angle = SUN, 0.1
    lamp.matrix_world = mathutils.Vector(toward).to_track_quat("Z", "Y").to_matrix().to_4x4()
    return lamp


def material(paint: str | None) -> Any:
    made = bpy.data.materials.new("object")
    made.node_tree.nodes.clear()
    nodes = Nodes(made.node_tree)
    surface = nodes.add("ShaderNodeBsdfPrincipled", Roughness=0.45)
    if paint:
        image = nodes.add("ShaderNodeTexImage")
        image.image = bpy.data.images.load(paint)
        colour = image.outputs["Color"]
    else:
        where = nodes.add("ShaderNodeTexCoord").outputs["Generated"]
        noise = nodes.add("ShaderNodeTexNoise", Vector=where, Scale=3.5, Detail=1.0)
        ramp = nodes.add("ShaderNodeValToRGB", Fac=noise.outputs["Fac"])
        low, high = ramp.color_ramp.elements
        low.position, low.color = 0.49, (0.75, 0.62, 0.42, 1.0)
        high.position, high.color = 0.51, (0.13, 0.05, 0.02, 1.0)
        colour = ramp.outputs["Color"]
    nodes.put(surface.inputs["Base Color"], colour)
    nodes.put(nodes.add("ShaderNodeOutputMaterial").inputs["Surface"], surface.outputs["BSDF"])
    return made


if __name__ == "__main__":
    sys.exit(main())
