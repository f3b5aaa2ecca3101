"""When, where and by which program something was made: what records state and reports show."""

import platform
from datetime import UTC, datetime
from typing import Self

from pydantic import AwareDatetime

from fpplab.core.config import Document
from fpplab.core.version import __version__


class DeviceIdentity(Document):
    """Which device it was."""

    model: str
    """As the device reports it."""
    serial: str
    """As the device reports it; empty where it has none."""
    offset_px: tuple[int, int] | None = None
    """Of a camera: column and row of the sensor where its frames begin, in px; None where it is unknown."""

    @property
    def description(self) -> str:
        return f"{self.model}, serial {self.serial}" if self.serial else f"{self.model}, no serial number"


class Origin(Document):
    """When, where and by which program a file was made."""

    made: AwareDatetime
    """Date and time, with the time zone."""
    host: str
    """Name of the computer."""
    version: str
    """Of fpplab."""

    @classmethod
    def now(cls, **more: object) -> Self:
        made = datetime.now(UTC).replace(microsecond=0)
        return cls.model_validate({"made": made, "host": platform.node(), "version": __version__, **more})
