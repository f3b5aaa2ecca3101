"""Nodes of the `genicam` package with the methods of pylon's parameters.

So `drivers.genicam.features` uses either. A node that the camera does not implement is not valid; one that it
does not offer in its present mode is neither readable nor writable.
"""

from typing import Any

from genicam import genapi

READABLE = (genapi.EAccessMode.RO, genapi.EAccessMode.RW)
WRITABLE = (genapi.EAccessMode.WO, genapi.EAccessMode.RW)


class MissingNode:
    """A feature that the camera does not have."""

    def IsValid(self) -> bool:
        return False

    IsReadable = IsWritable = IsValid


class SwitchNode:
    """A node with a value; a boolean one has nothing else."""

    def __init__(self, node: Any) -> None:
        self._node = node

    def IsValid(self) -> bool:
        return bool(self._mode() != genapi.EAccessMode.NI)

    def IsReadable(self) -> bool:
        return self._mode() in READABLE

    def IsWritable(self) -> bool:
        return self._mode() in WRITABLE

    def GetValue(self) -> Any:
        return self._node.value

    def SetValue(self, value: Any) -> None:
        self._node.value = value

    def _mode(self) -> Any:
        return self._node.get_access_mode()


class NumberNode(SwitchNode):
    """An integer or a float."""

    def GetMin(self) -> Any:
        return self._node.min

    def GetMax(self) -> Any:
        return self._node.max

    def HasInc(self) -> bool:
        return bool(self._node.has_inc())

    def GetInc(self) -> Any:
        return self._node.inc

    def GetUnit(self) -> str:
        """Return the unit, empty where the camera states none."""
        return str(self._node.unit)


class ChoiceNode(SwitchNode):
    """An enumeration."""

    def GetSettableValues(self) -> tuple[str, ...]:
        return tuple(entry.symbolic for entry in self._node.entries if entry.get_access_mode() in READABLE)


class CommandNode(SwitchNode):
    """A command."""

    def Execute(self) -> None:
        self._node.execute()


KINDS: dict[type, type[SwitchNode]] = {
    genapi.IInteger: NumberNode,
    genapi.IFloat: NumberNode,
    genapi.IEnumeration: ChoiceNode,
    genapi.ICommand: CommandNode,
}
"""By the interface of GenApi; any other node has a value only."""


class GentlNodeMap:
    """A node map that answers as pylon's does."""

    def __init__(self, nodes: Any) -> None:
        self._nodes = nodes

    def GetNode(self, name: str) -> Any:
        try:
            node = self._nodes.get_node(name)
        except genapi.LogicalErrorException:
            return MissingNode()
        return KINDS.get(type(node), SwitchNode)(node)
