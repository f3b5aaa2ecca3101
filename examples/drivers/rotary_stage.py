"""A Kinesis rotation mount of Thorlabs, by pylablib: a stage that turns.

stages:
  turntable: {backend: "rotary_stage:RotaryStage", serial: "55000001"}
"""

import time
from typing import Any

from pylablib.devices import Thorlabs

from fpplab.core.errors import ConfigError, DeviceTimeoutError
from fpplab.devices import DeviceInfo, Stage, StageCaps

POLL_S = 0.02


class RotaryStage(Stage):
    """A rotation mount by its serial number; it turns from 0 to 360 degrees."""

    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        self._serial = options.pop("serial", None)
        if not isinstance(self._serial, str):
            raise ConfigError(f"'{self.name}.serial' must be the mount's serial number, in quotes")
        super()._setup(options, shared)

    def _open(self) -> None:
        self._motor = Thorlabs.KinesisMotor(self._serial, scale="stage")

    def _close(self) -> None:
        if hasattr(self, "_motor"):
            try:
                self._halt()
            finally:
                self._motor.close()

    def _info(self) -> DeviceInfo:
        return DeviceInfo("stage", self._motor.get_device_info().model_no, self._serial, "USB")

    def _caps(self) -> StageCaps:
        return StageCaps((0.0, 360.0), unit="deg")

    def _home(self) -> None:
        self._motor.home(sync=True, force=True)

    def _move_to(self, mm: float, deadline_s: float) -> None:
        self._motor.move_to(mm)
        while self._motor.is_moving():
            if time.monotonic() > deadline_s:
                self._halt()
                raise DeviceTimeoutError(
                    self.name, "move_to", f"is at {self._position_mm():g} degrees", "allow more time"
                )
            time.sleep(POLL_S)

    def _position_mm(self) -> float:
        return float(self._motor.get_position())

    def _halt(self) -> None:
        self._motor.stop(immediate=True, sync=True)
