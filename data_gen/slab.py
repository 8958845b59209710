"""The 3 × 3 slab: what camera rays may see of it, and the soil.

Alphabet
    frame     the unit box [0, 1]³, z up; copies of the patch at integer offsets (i, j), i and j in {−1, 0, 1}
    inside    a blade wholly in the box: an ordinary object
    outside   a blade that misses the box: hidden from camera rays by the object's own flag
    straddler the others: their material turns transparent to camera rays where the position is outside the box

Secondary rays meet all of the slab, so light near the box's walls is right (paper, section 5.2).  The object's flag
costs nothing and the shader's clip costs a ray a layer, so only straddlers pay for it.  The soil is raised a little:
lying exactly on the box's floor it dots the picture.
"""

import itertools

import bpy
import numpy as np

from data_gen.grass import Blades
from data_gen.leaf import Nodes

SOIL_HEIGHT = 0.03
SOIL_ALBEDO = (0.09, 0.06, 0.035, 1.0)


def build(patch: Blades, leaf: bpy.types.NodeTree) -> None:
    """Three objects of blades and one of soil, in the current scene."""
    blades = tiled(patch)
    whole = material("leaf", leaf, clip=False)
    kinds = classify(blades)
    for kind, chosen in kinds.items():
        surface = material("leaf clipped", leaf, clip=True) if kind == "straddler" else whole
        blade_object(kind, blades, chosen, surface).visible_camera = kind != "outside"
    soil()


def tiled(patch: Blades) -> Blades:
    """All nine copies of a patch."""
    offsets = np.array([(i, j, 0.0) for i, j in itertools.product((-1.0, 0.0, 1.0), repeat=2)])
    copies = offsets[:, None, None] + patch.vertices[None]
    return patch._replace(
        vertices=copies.reshape(-1, *patch.vertices.shape[1:]),
        tone=np.tile(patch.tone, 9),
        resist=np.tile(patch.resist, 9),
        dry=np.tile(patch.dry, 9),
    )


def classify(blades: Blades) -> dict[str, np.ndarray]:
    """Masks over the blades.  The box is convex, so vertices inside it keep their triangles inside it; a blade is
    outside when the bounding box of each of its triangles misses the box (safe: at worst too many straddlers)."""
    within = ((blades.vertices >= 0.0) & (blades.vertices <= 1.0)).all(axis=(1, 2))
    corners = blades.vertices[:, blades.triangles]
    miss = (corners.max(axis=2) < 0.0) | (corners.min(axis=2) > 1.0)
    without = miss.any(axis=2).all(axis=1)
    return {"inside": within, "outside": without, "straddler": ~within & ~without}


def blade_object(name: str, blades: Blades, chosen: np.ndarray, surface: bpy.types.Material) -> bpy.types.Object:
    """One mesh of the chosen blades, smooth-shaded, with the blade's attributes on its points."""
    vertices = blades.vertices[chosen]
    n, v = vertices.shape[:2]
    triangles = (np.arange(n)[:, None, None] * v + blades.triangles).reshape(-1, 3)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.reshape(-1, 3), [], triangles)
    attributes = {"along": np.tile(blades.along, n)}
    for field in ("tone", "resist", "dry"):
        attributes[field] = np.repeat(getattr(blades, field)[chosen], v)
    for field, values in attributes.items():
        mesh.attributes.new(field, "FLOAT", "POINT").data.foreach_set("value", values.astype(np.float32))
    mesh.shade_smooth()
    mesh.materials.append(surface)
    return link(name, mesh)


def material(name: str, leaf: bpy.types.NodeTree, clip: bool) -> bpy.types.Material:
    made = empty_material(name)
    n = Nodes(made.node_tree)
    group = n.add("ShaderNodeGroup")
    group.node_tree = leaf
    shader = group.outputs["Shader"]
    if clip:
        made.use_transparent_shadow = False
        shader = clipped(n, shader)
    n.put(n.add("ShaderNodeOutputMaterial").inputs["Surface"], shader)
    return made


def clipped(n: Nodes, shader: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """The shader, transparent to camera rays where max |P − 0.5| > 0.5."""
    position = n.add("ShaderNodeNewGeometry").outputs["Position"]
    apart = n.vector("ABSOLUTE", n.vector("SUBTRACT", position, (0.5, 0.5, 0.5)))
    axes = n.add("ShaderNodeSeparateXYZ", Vector=apart).outputs
    farthest = n.math("MAXIMUM", n.math("MAXIMUM", axes[0], axes[1]), axes[2])
    camera_ray = n.add("ShaderNodeLightPath").outputs["Is Camera Ray"]
    hide = n.math("MULTIPLY", n.math("GREATER_THAN", farthest, 0.5), camera_ray)
    mix = n.add("ShaderNodeMixShader", Fac=hide)
    n.put(mix.inputs[1], shader)
    n.put(mix.inputs[2], n.add("ShaderNodeBsdfTransparent").outputs[0])
    return mix.outputs[0]


def soil() -> None:
    made = empty_material("soil")
    n = Nodes(made.node_tree)
    surface = n.add("ShaderNodeBsdfDiffuse", Color=SOIL_ALBEDO).outputs[0]
    n.put(n.add("ShaderNodeOutputMaterial").inputs["Surface"], surface)
    square = [(x, y, SOIL_HEIGHT) for x, y in ((-1, -1), (2, -1), (2, 2), (-1, 2))]
    mesh = bpy.data.meshes.new("soil")
    mesh.from_pydata(square, [], [(0, 1, 2, 3)])
    mesh.materials.append(made)
    link("soil", mesh).visible_camera = False


def empty_material(name: str) -> bpy.types.Material:
    made = bpy.data.materials.new(name)
    made.node_tree.nodes.clear()
    return made


def link(name: str, data: bpy.types.ID) -> bpy.types.Object:
    made = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(made)
    return made
