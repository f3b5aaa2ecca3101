"""Errors that are expected to happen, grouped by what has to be corrected, each group with an exit code."""

from __future__ import annotations


class FppError(Exception):
    """Base of every foreseeable error."""

    exit_code = 1  # of a command that ends with it

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)
        self.details: dict[str, object] = {}  # further figures for `--json`


class ConfigError(FppError):
    """A rig, plan, target or command-line value is wrong: correct the input."""

    exit_code = 2


class DeviceError(FppError):
    """An instrument failed or refused: check the rig."""

    exit_code = 3

    def __init__(self, device: str, operation: str, found: str, remedy: str = "") -> None:
        # device: its name in the rig file; operation: what was being done; remedy: what the operator can do
        self.device, self.operation, self.found, self.remedy = device, operation, found, remedy
        advice = f"; {remedy}" if remedy else ""
        super().__init__(f"{device}: {operation}: {found}{advice}")

    def __reduce__(self) -> tuple[type[DeviceError], tuple[str, str, str, str]]:
        """Pickle by the arguments, since errors also come from other processes."""
        return type(self), (self.device, self.operation, self.found, self.remedy)


class NotOpenError(DeviceError):
    """The device was used before `open` or after `close`."""


class StateError(DeviceError):
    """The operation is not allowed in the device's present state."""


class CapabilityError(DeviceError):
    """The device cannot do this at all."""


class SettingError(DeviceError):
    """A setting lies outside what the device accepts."""


class LimitError(DeviceError):
    """A motion would leave the travel."""


class DeviceTimeoutError(DeviceError):
    """The device did not answer in time."""


class ProtocolError(DeviceError):
    """The device answered something that its protocol does not allow."""


class FrameLossError(DeviceError):
    """A frame is missing or damaged."""


class SyncError(DeviceError):
    """A frame shows another pattern than the one asked for."""


class DisconnectedError(DeviceError):
    """The device is gone: unplugged, switched off, or its process died."""


class DataError(FppError):
    """Recorded data are missing, damaged or of another kind than expected."""

    exit_code = 4


class CalibrationError(FppError):
    """Characterisation failed, or does not fit the data it is used on."""

    exit_code = 5


class UndeterminedError(CalibrationError):
    """The poses do not determine the devices: more of them would, tilted differently."""


class Cancelled(FppError):  # noqa: N818 - not an error: the user's own wish
    """The user stopped the work."""

    exit_code = 130
