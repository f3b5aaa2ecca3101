"""Arithmetic as a shader node tree."""

from typing import Any


class Nodes:
    """Adds nodes to a tree. A value is a number, a tuple of numbers for a vector or a colour, or a socket."""

    def __init__(self, tree: Any) -> None:
        self.tree = tree

    def add(self, kind: str) -> Any:
        return self.tree.nodes.new(kind)

    def join(self, value: Any, socket: Any) -> None:
        if isinstance(value, float | int | tuple):
            socket.default_value = value
        else:
            self.tree.links.new(value, socket)

    def math(self, operation: str, *values: Any) -> Any:
        return self._operate("ShaderNodeMath", operation, values).outputs["Value"]

    def vector(self, operation: str, *values: Any) -> Any:
        return self._operate("ShaderNodeVectorMath", operation, values).outputs["Vector"]

    def dot(self, vector: Any, other: Any) -> Any:
        return self._operate("ShaderNodeVectorMath", "DOT_PRODUCT", (vector, other)).outputs["Value"]

    def scaled(self, vector: Any, factor: Any) -> Any:
        node = self._operate("ShaderNodeVectorMath", "SCALE", (vector,))
        self.join(factor, node.inputs["Scale"])
        return node.outputs["Vector"]

    def combine(self, kind: str, values: tuple[Any, ...]) -> Any:
        node = self.add(kind)
        for value, socket in zip(values, node.inputs, strict=False):
            self.join(value, socket)
        return node.outputs[0]

    def total(self, *values: Any) -> Any:
        result = values[0]
        for value in values[1:]:
            result = self.math("ADD", result, value)
        return result

    def times(self, *values: Any) -> Any:
        result = values[0]
        for value in values[1:]:
            result = self.math("MULTIPLY", result, value)
        return result

    def _operate(self, kind: str, operation: str, values: tuple[Any, ...]) -> Any:
        node = self.add(kind)
        node.operation = operation
        for value, socket in zip(values, node.inputs, strict=False):
            self.join(value, socket)
        return node
