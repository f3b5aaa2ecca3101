"""Camera features by their GenICam names, resolved in the camera's node map.

Cameras differ by model and by the version of the Standard Features Naming Convention (SFNC). A feature is
therefore a tuple of names, see `drivers.genicam.names`; the first that the camera has is used. Which library
the node map comes from does not matter here: a node is anything with the methods of pylon's parameters. An
enumeration has `GetSettableValues`, a switch has no `GetMin`, and integers are recognised by the type of
their minimum.
"""

import logging
from typing import Any

from fpplab.core.errors import CapabilityError, SettingError
from fpplab.core.logs import log_traffic

_log = logging.getLogger(__name__)
FeatureNames = tuple[str, ...]  # names of one feature, in order of preference


class Features:
    """The GenICam features of one open camera."""

    def __init__(self, device: str, camera: Any) -> None:
        # The node map is fetched for each access: a stored one would answer for an unplugged camera.
        self._device, self._camera = device, camera
        self.accepted: tuple[
            str, ...
        ] = ()  # names of features that may keep another value than `ensure` sets

    def has(self, feature: FeatureNames) -> bool:
        """Tell whether the camera has a feature in its present mode."""
        return bool(self._node(feature).IsValid())

    def read(self, feature: FeatureNames) -> Any:
        node = self._node(feature)
        return node.GetValue() if node.IsReadable() else None

    def limits(self, feature: FeatureNames) -> tuple[float, float]:
        """Read the range that a numeric feature takes at present."""
        node = self._node(feature)
        if not node.IsReadable():
            raise CapabilityError(self._device, "caps", f"the camera has no {feature[0]}")
        return float(node.GetMin()), float(node.GetMax())

    def step(self, feature: FeatureNames) -> float:
        """Read the step of a number that is not whole; 0 where the camera states none."""
        node = self._node(feature)
        stated = node.IsValid() and not _is_integer(node) and node.HasInc()
        return float(node.GetInc()) if stated else 0.0

    def choices(self, feature: FeatureNames) -> tuple[str, ...]:
        """List the values that an enumeration can be set to at present."""
        node = self._node(feature)
        return tuple(node.GetSettableValues()) if node.IsWritable() else ()

    def write(self, feature: FeatureNames, value: Any, operation: str, tolerance: float = 0.0) -> Any:
        """Set a feature and read it back."""
        name, node = self._named_node(feature)
        if not node.IsWritable():
            if node.IsReadable() and node.GetValue() == value:
                return value
            raise CapabilityError(
                self._device, operation, f"{name} cannot be set to {value}", "this camera has no such setting"
            )
        if refusal := _describe_refusal(node, value):
            raise SettingError(
                self._device, operation, f"{name} is {_shown(value)}", f"the camera takes {refusal}"
            )
        node.SetValue(int(value) if _is_integer(node) else value)
        back = node.GetValue()
        log_traffic(self._device, "to", f"{name} = {value}")
        log_traffic(self._device, "from", f"{name} = {back}")
        if back != value and not (tolerance and abs(back - value) <= tolerance):
            raise SettingError(
                self._device, operation, f"{name} is {_shown(value)}", f"the camera reads {_shown(back)}"
            )
        return back

    def ensure(self, feature: FeatureNames, value: Any, operation: str) -> None:
        """Set a feature where the camera has it, and verify it."""
        self.write_if_possible(feature, value)
        name, read_back = self._named_node(feature)[0], self.read(feature)
        if read_back is None or read_back == value:
            return
        kept = f"{name} is {_shown(read_back)} and cannot be set to {_shown(value)}"
        if name not in self.accepted:
            remedy = (
                f"correct it in the maker's viewer, or accept it by `accept_raw: [{name}]` in the rig file"
            )
            raise SettingError(
                self._device, operation, kept, f"frames would not be the sensor's own values; {remedy}"
            )
        _log.warning("%s: %s; the rig file accepts it", self._device, kept)

    def write_if_possible(self, feature: FeatureNames, value: Any) -> None:
        """Set a feature where the camera takes the value; otherwise leave it unchanged."""
        node = self._node(feature)
        if node.IsWritable() and not _describe_refusal(node, value):
            node.SetValue(value)

    def unit(self, feature: FeatureNames) -> str | None:
        node = self._node(feature)
        return str(node.GetUnit()) if node.IsValid() else None

    def execute(self, feature: FeatureNames, operation: str) -> None:
        name, node = self._named_node(feature)
        if not node.IsWritable():
            raise CapabilityError(self._device, operation, f"the camera does not take {name} at present")
        log_traffic(self._device, "to", name)
        node.Execute()

    def _node(self, feature: FeatureNames) -> Any:
        return self._named_node(feature)[1]

    def _named_node(self, feature: FeatureNames) -> tuple[str, Any]:
        """Return the name by which the camera has a feature, and its node; else the first name."""
        node_map = self._camera.GetNodeMap()
        nodes = [(name, node_map.GetNode(name)) for name in feature]
        return next(((name, node) for name, node in nodes if node.IsValid()), nodes[0])


def _is_integer(node: Any) -> bool:
    return hasattr(node, "GetMin") and isinstance(node.GetMin(), int)


def _describe_refusal(node: Any, value: Any) -> str:
    """Describe what the node accepts, if it does not take the value; otherwise return an empty string."""
    if hasattr(node, "GetSettableValues"):
        choices = node.GetSettableValues()
        return "" if value in choices else f"one of {', '.join(choices)}"
    if not hasattr(node, "GetMin"):
        return ""
    minimum, maximum = node.GetMin(), node.GetMax()
    step = node.GetInc() if _is_integer(node) else 0
    if step and value != int(value):
        return f"whole numbers from {minimum:g} to {maximum:g}"
    if minimum <= value <= maximum and not (step and (value - minimum) % step):
        return ""
    return f"{minimum:g} to {maximum:g}" + (f" in steps of {step}" if step > 1 else "")


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
