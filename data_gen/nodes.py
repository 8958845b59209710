"""A Blender node tree written as expressions: every method adds a node and returns its output socket.

Notation
    socket    where a value enters or leaves a node; any operand may be a socket or a constant
"""

from typing import Any

Socket = Any
Operand = Any


class Nodes:
    """Writes into one tree."""

    def __init__(self, tree: Any) -> None:
        self.tree = tree

    def add(self, kind: str, **inputs: Operand) -> Any:
        node = self.tree.nodes.new(kind)
        for name, value in inputs.items():
            self.put(node.inputs[name], value)
        return node

    def put(self, socket: Socket, value: Operand) -> None:
        if hasattr(value, "is_output"):
            self.tree.links.new(value, socket)
        else:
            socket.default_value = value

    def put_all(self, sockets: Any, *values: Operand) -> None:
        for socket, value in zip(sockets, values, strict=False):
            self.put(socket, value)

    def attribute(self, name: str) -> Socket:
        """A number that the geometry carries, by its name."""
        node = self.add("ShaderNodeAttribute")
        node.attribute_name = name
        return node.outputs["Fac"]

    def math(self, operation: str, *operands: Operand, clamp: bool = False) -> Socket:
        node = self.add("ShaderNodeMath")
        node.operation, node.use_clamp = operation, clamp
        self.put_all(node.inputs, *operands)
        return node.outputs[0]

    def vector(self, operation: str, *operands: Operand) -> Socket:
        node = self.add("ShaderNodeVectorMath")
        node.operation = operation
        self.put_all(node.inputs, *operands)
        return node.outputs[0]

    def affine(self, x: Operand, slope: float, offset: float) -> Socket:
        """slope · x + offset."""
        return self.math("MULTIPLY_ADD", x, slope, offset)

    def lerp(self, weight: Operand, low: tuple[float, ...], high: tuple[float, ...]) -> Socket:
        """low + weight · (high − low), by vector arithmetic."""
        step = tuple(b - a for a, b in zip(low, high, strict=True))
        return self.vector("MULTIPLY_ADD", self.spread(weight), step, low)

    def spread(self, value: Operand) -> Socket:
        return self.add("ShaderNodeCombineXYZ", X=value, Y=value, Z=value).outputs[0]

    def hsv(self, hue: Operand, saturation: Operand, value: Operand) -> Socket:
        """Linear Rec. 709 of hue, saturation and value, all in [0, 1]."""
        node = self.add("ShaderNodeCombineColor")
        node.mode = "HSV"
        self.put_all(node.inputs, hue, saturation, value)
        return node.outputs[0]

    def mix(self, weight: Operand, first: Socket, second: Socket) -> Socket:
        """Shader `first` where the weight is 0, `second` where it is 1."""
        node = self.add("ShaderNodeMixShader", Fac=weight)
        self.put_all(node.inputs[1:], first, second)
        return node.outputs[0]

    def both(self, first: Socket, second: Socket) -> Socket:
        """The sum of two shaders."""
        node = self.add("ShaderNodeAddShader")
        self.put_all(node.inputs, first, second)
        return node.outputs[0]
