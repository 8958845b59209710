"""Run by Blender's Python: a room with two lamps, rendered by Cycles and written as a USD stage (docs/how_to/blender_scene.md).

    data_gen/.venv/bin/python experiments/scenes/lamps.py FOLDER

writes FOLDER/blender.exr and FOLDER/room.usdc. The floor has two materials, wood and, in its middle, that of a rug.
"""

import math
import sys
from pathlib import Path

import bpy  # type: ignore

FOLDER = Path(sys.argv[1]).resolve()


def material(name: str, red: float, green: float, blue: float):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    inputs = made.node_tree.nodes["Principled BSDF"].inputs
    inputs["Base Color"].default_value = (red, green, blue, 1)
    inputs["Roughness"].default_value, inputs["Specular IOR Level"].default_value = 1, 0
    return made


def newest(name: str, *materials):
    bpy.context.object.name = name
    for one in materials:
        bpy.context.object.data.materials.append(one)
    return bpy.context.object


def lamp(kind: str, location: tuple, turn: float, color: tuple, **more) -> None:
    made = bpy.data.objects.new(kind, bpy.data.lights.new(kind, kind))
    for key, value in (more | {"color": color}).items():
        setattr(made.data, key, value)
    made.location, made.rotation_euler = location, (turn, 0, 0)
    bpy.context.collection.objects.link(made)


bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_grid_add(x_subdivisions=10, y_subdivisions=10, size=4)
floor = newest("Floor", material("Wood", 0.45, 0.27, 0.13), material("Rug", 0.2, 0.1, 0.05))
for polygon in floor.data.polygons:
    polygon.material_index = int(abs(polygon.center.x) < 1.2 and abs(polygon.center.y + 0.2) < 1.0)
wall = material("Wall", 0.7, 0.68, 0.6)
for name, location, turn in (("Back", (0, 2, 1.25), 0.0), ("Left", (-2, 0, 1.25), math.pi / 2)):
    bpy.ops.mesh.primitive_plane_add(size=2, location=location, rotation=(math.pi / 2, 0, turn))
    newest(name, wall).scale = (2, 1.25, 1)
bpy.ops.mesh.primitive_monkey_add(location=(-0.35, 0.5, 0.52), rotation=(-0.35, 0, 0.35), size=0.9)
newest("Head", material("Red", 0.6, 0.05, 0.03))
bpy.ops.mesh.primitive_cube_add(location=(1.35, 1.2, 0.35), rotation=(0, 0, 0.5), size=0.7)
newest("Box", material("Blue", 0.05, 0.12, 0.5))
lamp("AREA", (0.4, -1.2, 2.9), -0.35, (0.85, 0.93, 1.0), energy=70, shape="RECTANGLE", size=1.4, size_y=0.9)
lamp("POINT", (1.25, -0.1, 0.75), 0.0, (1.0, 0.62, 0.3), energy=14, shadow_soft_size=0.06)
lens = bpy.data.cameras.new("Camera")
lens.lens = 34
camera = bpy.data.objects.new("Camera", lens)
camera.location, camera.rotation_euler = (1.6, -3.9, 2.1), (math.radians(66), 0, math.radians(20))
bpy.context.collection.objects.link(camera)
scene = bpy.context.scene
scene.camera, scene.world, scene.render.engine = camera, None, "CYCLES"
scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", 256, False
scene.render.resolution_x, scene.render.resolution_y = 480, 300
scene.render.image_settings.file_format, scene.render.filepath = "OPEN_EXR", str(FOLDER / "blender.exr")
bpy.ops.render.render(write_still=True)
bpy.ops.wm.usd_export(filepath=str(FOLDER / "room.usdc"))
