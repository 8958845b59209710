"""Run by Blender's Python: a head on a stand, seen by a camera, as a mask and in every mesh format.

FOLDER, which has sky.exr and board.png, gets sky_0.exr to sky_7.exr, what is seen of the sky in eight directions, sky.usda,
mapped.usdc and upright.usda, whose y is up; the same of the sky turned by 90 degrees, turned_0.exr to turned_7.exr and
turned.usdz; of each lamp NAME, NAME.exr, what is seen of a white floor below it, NAME.usdc and NAME.glb; of a board that wears
board.png, under a sun, board.exr, .glb, .gltf, .usdc and .usdz; mask.png, view.json (the camera's frame and vertical field of
view) and head.glb, .gltf, .usda, .usdc, .usdz, .obj, .ply and .stl, by Blender's own settings but for cameras."""

import json
import math
import sys
from pathlib import Path

import bpy  # type: ignore
from mathutils import Vector  # type: ignore

FOLDER = Path(sys.argv[1])
WIDTH, HEIGHT = 120, 90
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_monkey_add(location=(0.3, -0.2, 0.5), rotation=(0.4, 0.2, 0.9), size=1.6)
bpy.context.object.name = "Monkey"
bpy.context.object["mesoshell:material"], bpy.context.object["mesoshell:scale"] = "pelt", 0.25
bpy.ops.mesh.primitive_cone_add(location=(-0.6, 0.7, -0.2), rotation=(0.1, 0.9, 0.0))
lens = bpy.data.cameras.new("Camera")
lens.lens, lens.sensor_fit = 40, "AUTO"
camera = bpy.data.objects.new("Camera", lens)
camera.location, camera.rotation_euler = (3.4, -3.1, 2.4), (math.radians(62), 0.07, math.radians(47))
bpy.context.collection.objects.link(camera)
scene = bpy.context.scene
scene.camera = camera
scene.render.engine = "CYCLES"
scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", 1, False
scene.cycles.pixel_filter_type, scene.render.film_transparent = "BOX", True
scene.cycles.filter_width = 0.01  # rays through the middles of pixels
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"
scene.render.filepath = str(FOLDER / "mask.png")
bpy.ops.render.render(write_still=True)
view = {"to_world": [list(row) for row in camera.matrix_world], "fov": 2 * math.atan(36 * HEIGHT / WIDTH / 2 / 40)}
(FOLDER / "view.json").write_text(json.dumps(view))
for form, kind in (("GLB", "glb"), ("GLTF_SEPARATE", "gltf")):
    bpy.ops.export_scene.gltf(
        filepath=str(FOLDER / f"head.{kind}"), export_format=form, export_cameras=True, export_extras=True
    )
for kind in ("usda", "usdc", "usdz"):
    bpy.ops.wm.usd_export(filepath=str(FOLDER / f"head.{kind}"))
bpy.ops.wm.obj_export(filepath=str(FOLDER / "head.obj"))
bpy.ops.wm.ply_export(filepath=str(FOLDER / "head.ply"))
bpy.ops.wm.stl_export(filepath=str(FOLDER / "head.stl"))
for one in list(bpy.data.objects):
    if one.type == "MESH":
        bpy.data.objects.remove(one)
scene.world = bpy.data.worlds.new("World")
scene.world.use_nodes = True
tree = scene.world.node_tree
image = tree.nodes.new("ShaderNodeTexEnvironment")
image.image, image.interpolation = bpy.data.images.load(str(FOLDER / "sky.exr")), "Closest"
tree.links.new(image.outputs[0], tree.nodes["Background"].inputs[0])
scene.render.film_transparent, lens.angle = False, 0.01
scene.render.resolution_x = scene.render.resolution_y = 2
scene.render.image_settings.file_format = "OPEN_EXR"


def look_around(name: str) -> None:
    for k in range(8):
        angle = (k + 0.5) * math.pi / 4
        toward = Vector((math.cos(angle), math.sin(angle), 0.4))
        camera.rotation_euler = toward.to_track_quat("-Z", "Y").to_euler()
        scene.render.filepath = str(FOLDER / f"{name}_{k}.exr")
        bpy.ops.render.render(write_still=True)


look_around("sky")
bpy.ops.mesh.primitive_cube_add(location=(0, 0, -9))
bpy.ops.wm.usd_export(filepath=str(FOLDER / "sky.usda"))
upright = {"export_global_forward_selection": "NEGATIVE_Z", "export_global_up_selection": "Y"}
bpy.ops.wm.usd_export(filepath=str(FOLDER / "upright.usda"), convert_orientation=True, **upright)
mapping, place = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
tree.links.new(place.outputs["Generated"], mapping.inputs[0])
tree.links.new(mapping.outputs[0], image.inputs[0])
bpy.ops.wm.usd_export(filepath=str(FOLDER / "mapped.usdc"))
mapping.inputs["Rotation"].default_value = (0, 0, math.pi / 2)
bpy.ops.wm.usd_export(filepath=str(FOLDER / "turned.usdz"))
look_around("turned")


def show_lamp(name: str, kind: str, **shape: float | str) -> None:
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", kind))
    lamp.data.energy, lamp.data.color = 100, (1, 0.5, 0.25)
    for key, value in shape.items():
        setattr(lamp.data, key, value)
    lamp.location, lamp.rotation_euler = (0.5, 0.3, 2.0), (0.1, 0.2, 0.3)
    bpy.context.collection.objects.link(lamp)
    scene.render.filepath = str(FOLDER / f"{name}.exr")
    bpy.ops.render.render(write_still=True)
    bpy.ops.wm.usd_export(filepath=str(FOLDER / f"{name}.usdc"))
    bpy.ops.export_scene.gltf(filepath=str(FOLDER / f"{name}.glb"), export_lights=True)
    bpy.data.objects.remove(lamp)


bpy.ops.mesh.primitive_plane_add(size=2)
white = bpy.data.materials.new("White")
white.use_nodes = True
white.node_tree.nodes.clear()
diffuse = white.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
white.node_tree.links.new(diffuse.outputs[0], white.node_tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
bpy.context.object.data.materials.append(white)
camera.location, camera.rotation_euler = (0, 0, 4), (0, 0, 0)
scene.world, scene.cycles.samples = None, 256
show_lamp("point", "POINT", shadow_soft_size=0.1)
show_lamp("bare", "POINT", shadow_soft_size=0.0)
show_lamp("spot", "SPOT", shadow_soft_size=0.1, spot_size=1.2, spot_blend=0.15)
show_lamp("rectangle", "AREA", shape="RECTANGLE", size=0.3, size_y=0.2)
show_lamp("disk", "AREA", shape="DISK", size=0.3)
board = bpy.context.object
board.name = "Board"
painted = bpy.data.materials.new("Painted")
painted.use_nodes = True
shader = painted.node_tree.nodes["Principled BSDF"]
shader.inputs["Specular IOR Level"].default_value, shader.inputs["Roughness"].default_value = 0.0, 1.0
texture = painted.node_tree.nodes.new("ShaderNodeTexImage")
texture.image, texture.interpolation = bpy.data.images.load(str(FOLDER / "board.png")), "Closest"
painted.node_tree.links.new(texture.outputs[0], shader.inputs["Base Color"])
board.data.materials[0] = painted
for corner in board.data.uv_layers[0].data:  # turned, and repeated
    corner.uv = 1.5 * corner.uv[1] - 0.25, corner.uv[0]
bpy.ops.mesh.primitive_plane_add(size=0.5, location=(0, 0, -50))
bpy.context.object.name = "Lawn"
sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
sun.data.energy = math.pi
bpy.context.collection.objects.link(sun)
scene.render.resolution_x = scene.render.resolution_y = 24
camera.location, lens.angle, scene.cycles.samples = (0, 0, 100), 2 * math.atan(0.01), 16
scene.render.filepath = str(FOLDER / "board.exr")
bpy.ops.render.render(write_still=True)
for form, kind in (("GLB", "glb"), ("GLTF_SEPARATE", "gltf")):
    path = str(FOLDER / f"board.{kind}")
    bpy.ops.export_scene.gltf(filepath=path, export_format=form, export_cameras=True, export_lights=True)
for kind in ("usdc", "usdz"):
    bpy.ops.wm.usd_export(filepath=str(FOLDER / f"board.{kind}"))
