"""The 3 × 3 slab in Blender: what camera rays may see of it, and the ground.

Notation
    frame     the unit box [0, 1]³, z up; the slab covers [−1, 2)²
    inside    a piece wholly in the box: an ordinary object
    outside   a piece that misses the box: hidden from camera rays by the object's own flag
    straddler the others: their material turns transparent to camera rays where the position is outside the box

Secondary rays meet all of the slab, so light near the box's walls is right (paper, section 5.2).  The object's flag
costs nothing and the shader's clip costs a ray a layer, so only straddlers pay for it.
"""

import itertools

import bpy
import numpy as np

from data_gen.nodes import Nodes, Socket
from data_gen.recipe import Ground, Growth, Recipe

KINDS = ("inside", "outside", "straddler")
#: Hair curves round their corners: a segment may leave its points' bounding box by this share of its length.
ROUNDING = 0.25


class Slab:
    """One material a kind, made once; `fill` replaces the geometry, `set` the appearance."""

    def __init__(self, recipe: Recipe) -> None:
        self.materials: dict[str, bpy.types.Material] = {}
        self.values: dict[str, list[Socket]] = {}
        self.objects: list[bpy.types.Object] = []
        for kind in KINDS:
            self.materials[kind] = self._material(kind, recipe, clip=kind == "straddler")
        ground(recipe.ground)

    def set(self, name: str, value: float) -> None:
        """A parameter of the appearance."""
        for socket in self.values[name]:
            socket.default_value = value

    def fill(self, growth: Growth, side: int) -> None:
        """Replace what grows by this, which covers [0, side)²."""
        for made in self.objects:
            data = made.data
            bpy.data.objects.remove(made)
            store = bpy.data.meshes if isinstance(data, bpy.types.Mesh) else bpy.data.hair_curves
            store.remove(data)
        growth = over_slab(growth, side)
        make = mesh_of if growth.radius is None else curves_of
        self.objects = []
        for kind, chosen in classify(growth).items():
            if chosen.any():
                data = make(kind, take(growth, chosen))
                data.materials.append(self.materials[kind])
                self.objects.append(link(kind, data))
                self.objects[-1].visible_camera = kind != "outside"

    def _material(self, kind: str, recipe: Recipe, clip: bool) -> bpy.types.Material:
        made = empty_material(kind)
        n = Nodes(made.node_tree)
        sockets = {
            name: n.add("ShaderNodeValue").outputs[0] for name, p in recipe.parameters.items() if p.role == "alpha"
        }
        for name, socket in sockets.items():
            self.values.setdefault(name, []).append(socket)
        shader = recipe.surface(n, sockets)
        if clip:
            made.use_transparent_shadow = False
            shader = clipped(n, shader)
        n.put(n.add("ShaderNodeOutputMaterial").inputs["Surface"], shader)
        return made


def over_slab(growth: Growth, side: int) -> Growth:
    """A patch repeated nine times, or what covers the slab already, moved to [−1, 2)²."""
    steps = (-1.0, 0.0, 1.0) if side == 1 else (-1.0,)
    offsets = np.array([(i, j, 0.0) for i, j in itertools.product(steps, repeat=2)])
    n = len(offsets)
    return growth._replace(
        points=(offsets[:, None, None] + growth.points).reshape(-1, *growth.points.shape[1:]),
        radius=None if growth.radius is None else np.tile(growth.radius, (n, 1)),
        own={name: np.tile(values, n) for name, values in growth.own.items()},
    )


def take(growth: Growth, chosen: np.ndarray) -> Growth:
    return growth._replace(
        points=growth.points[chosen],
        radius=None if growth.radius is None else growth.radius[chosen],
        own={name: values[chosen] for name, values in growth.own.items()},
    )


def classify(growth: Growth) -> dict[str, np.ndarray]:
    """Masks (N,) over the pieces.  Safe: what cannot be told from bounding boxes of elements is a straddler."""
    corners = growth.points[:, growth.elements]
    low, high = corners.min(axis=2), corners.max(axis=2)
    if growth.radius is not None:
        margin = growth.radius.max(axis=1)[:, None, None] + ROUNDING * (high - low).max(axis=2, keepdims=True)
        low, high = low - margin, high + margin
    low, high = low[..., :2], high[..., :2]
    within = ((low >= 0.0) & (high <= 1.0)).all(axis=(1, 2))
    without = ((high < 0.0) | (low > 1.0)).any(axis=2).all(axis=1)
    return {"inside": within, "outside": without, "straddler": ~within & ~without}


def mesh_of(name: str, growth: Growth) -> bpy.types.Mesh:
    """Blades as one smooth-shaded mesh."""
    n, k = growth.points.shape[:2]
    triangles = (np.arange(n)[:, None, None] * k + growth.elements).reshape(-1, 3).astype(np.int32)
    made = bpy.data.meshes.new(name)
    made.vertices.add(n * k)
    made.vertices.foreach_set("co", flat(growth.points))
    made.loops.add(triangles.size)
    made.loops.foreach_set("vertex_index", triangles.reshape(-1))
    made.polygons.add(len(triangles))
    made.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    made.update(calc_edges=True)
    made.shade_smooth()
    put_attribute(made, "along", "POINT", np.tile(growth.along, n))
    for field, values in growth.own.items():
        put_attribute(made, field, "POINT", np.repeat(values, k))
    return made


def curves_of(name: str, growth: Growth) -> bpy.types.Curves:
    """Strands as hair curves."""
    n, k = growth.points.shape[:2]
    made = bpy.data.hair_curves.new(name)
    made.add_curves([k] * n)
    made.position_data.foreach_set("vector", flat(growth.points))
    put_attribute(made, "radius", "POINT", growth.radius)
    put_attribute(made, "along", "POINT", np.tile(growth.along, n))
    for field, values in growth.own.items():
        put_attribute(made, field, "CURVE", values)
    return made


def put_attribute(data: bpy.types.ID, name: str, domain: str, values: np.ndarray) -> None:
    data.attributes.new(name, "FLOAT", domain).data.foreach_set("value", flat(values))


def flat(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32).reshape(-1)


def clipped(n: Nodes, shader: Socket) -> Socket:
    """The shader, transparent to camera rays where max |P − 0.5| > 0.5."""
    position = n.add("ShaderNodeNewGeometry").outputs["Position"]
    apart = n.vector("ABSOLUTE", n.vector("SUBTRACT", position, (0.5, 0.5, 0.5)))
    axes = n.add("ShaderNodeSeparateXYZ", Vector=apart).outputs
    farthest = n.math("MAXIMUM", n.math("MAXIMUM", axes[0], axes[1]), axes[2])
    camera_ray = n.add("ShaderNodeLightPath").outputs["Is Camera Ray"]
    hide = n.math("MULTIPLY", n.math("GREATER_THAN", farthest, 0.5), camera_ray)
    return n.mix(hide, shader, n.add("ShaderNodeBsdfTransparent").outputs[0])


def ground(kind: Ground) -> None:
    made = empty_material("ground")
    n = Nodes(made.node_tree)
    diffuse = n.add("ShaderNodeBsdfDiffuse", Color=(*kind.albedo, 1.0)).outputs[0]
    n.put(n.add("ShaderNodeOutputMaterial").inputs["Surface"], diffuse)
    square = [(x, y, kind.height) for x, y in ((-1, -1), (2, -1), (2, 2), (-1, 2))]
    mesh = bpy.data.meshes.new("ground")
    mesh.from_pydata(square, [], [(0, 1, 2, 3)])
    mesh.materials.append(made)
    link("ground", mesh).visible_camera = False


def empty_material(name: str) -> bpy.types.Material:
    made = bpy.data.materials.new(name)
    made.node_tree.nodes.clear()
    return made


def link(name: str, data: bpy.types.ID) -> bpy.types.Object:
    made = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(made)
    return made
