"""The leaf: a thin sheet that reflects, lets light through and shines a little, as a Blender node group.

Alphabet
    a         how dead the leaf is at a point, in [0, 1]
    t         position along the blade (attribute `along`), 0 at the root
    R, T      diffuse reflectance and transmittance, linear Rec. 709
    gloss     weight of the glossy lobe, the same on either side

a = clamp(1.5 · age − 0.5 · resist + dry): at age 0 every leaf is fresh but the dry ones, at age 1 every leaf is dead,
and between the two the blades turn one after another.  R and T are interpolated in a between a fresh and a dead leaf;
T of a dead leaf is far lower, that is the transparency which age takes away.  Both are multiplied by
(0.45 + 0.75 t) · (0.75 + 0.5 tone): dark at the root, light at the tip, and no two blades alike.
"""

import bpy

FRESH_R, FRESH_T = (0.075, 0.17, 0.028), (0.10, 0.24, 0.02)
DEAD_R, DEAD_T = (0.34, 0.235, 0.095), (0.085, 0.05, 0.014)
GLOSS, ROUGHNESS = 0.05, 0.45


class Nodes:
    """Writes a node tree as expressions: every method adds one node and returns its output socket."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree

    def add(self, kind: str, **inputs: object) -> bpy.types.Node:
        node = self.tree.nodes.new(kind)
        for name, value in inputs.items():
            self.put(node.inputs[name], value)
        return node

    def put(self, socket: bpy.types.NodeSocket, value: object) -> None:
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        else:
            socket.default_value = value

    def attribute(self, name: str) -> bpy.types.NodeSocket:
        node = self.add("ShaderNodeAttribute")
        node.attribute_name = name
        return node.outputs["Fac"]

    def math(self, operation: str, *operands: object, clamp: bool = False) -> bpy.types.NodeSocket:
        node = self.add("ShaderNodeMath")
        node.operation, node.use_clamp = operation, clamp
        for socket, value in zip(node.inputs, operands, strict=False):
            self.put(socket, value)
        return node.outputs[0]

    def vector(self, operation: str, *operands: object) -> bpy.types.NodeSocket:
        node = self.add("ShaderNodeVectorMath")
        node.operation = operation
        for socket, value in zip(node.inputs, operands, strict=False):
            self.put(socket, value)
        return node.outputs[0]

    def lerp(self, weight: object, low: tuple[float, ...], high: tuple[float, ...]) -> bpy.types.NodeSocket:
        """low + weight · (high − low), by vector arithmetic."""
        step = tuple(b - a for a, b in zip(low, high, strict=True))
        return self.vector("MULTIPLY_ADD", self.spread(weight), step, low)

    def spread(self, value: object) -> bpy.types.NodeSocket:
        return self.add("ShaderNodeCombineXYZ", X=value, Y=value, Z=value).outputs[0]


def node_group() -> tuple[bpy.types.NodeTree, bpy.types.Node]:
    """The group, with one output `Shader`, and the value node that holds the age (one group serves all materials)."""
    group = bpy.data.node_groups.new("leaf", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    n = Nodes(group)
    age = n.add("ShaderNodeValue")

    late = n.math("MULTIPLY_ADD", n.attribute("resist"), -0.5, n.attribute("dry"))
    a = n.math("MULTIPLY_ADD", age.outputs[0], 1.5, late, clamp=True)
    by_height = n.math("MULTIPLY_ADD", n.attribute("along"), 0.75, 0.45)
    by_blade = n.math("MULTIPLY_ADD", n.attribute("tone"), 0.5, 0.75)
    shade = n.spread(n.math("MULTIPLY", by_height, by_blade))

    r = n.vector("MULTIPLY", n.lerp(a, FRESH_R, DEAD_R), shade)
    t = n.vector("MULTIPLY", n.lerp(a, FRESH_T, DEAD_T), shade)
    reflect = n.add("ShaderNodeBsdfDiffuse", Color=r).outputs[0]
    transmit = n.add("ShaderNodeBsdfTranslucent", Color=t).outputs[0]
    sheet = n.add("ShaderNodeAddShader")
    shine = n.add("ShaderNodeBsdfAnisotropic", Color=(1.0, 1.0, 1.0, 1.0), Roughness=ROUGHNESS).outputs[0]
    mixed = n.add("ShaderNodeMixShader", Fac=GLOSS)
    for socket, value in ((sheet.inputs[0], reflect), (sheet.inputs[1], transmit)):
        n.put(socket, value)
    for socket, value in ((mixed.inputs[1], sheet.outputs[0]), (mixed.inputs[2], shine)):
        n.put(socket, value)
    n.put(n.add("NodeGroupOutput").inputs["Shader"], mixed.outputs[0])
    return group, age
