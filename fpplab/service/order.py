"""What a client orders, and what the service reports of it."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from fpplab.core.config import Document
from fpplab.core.confirmation import ConfirmationRequired
from fpplab.core.errors import ConfigError
from fpplab.core.files import is_portable_name
from fpplab.service.state import ScanState


class ScanOrder(Document):
    """A scan, as the options of `fpplab scan` have it."""

    plan: str | dict[str, Any] = "plan_scan.yaml"
    """Plan file, the name of one that comes with fpplab, or the plan itself."""
    calibration: str | None = None
    """File that `fpplab characterise` wrote; by default the service's own."""
    out: str | None = None
    """Folder of the session; an interrupted one is completed. By default the next of the service's folder."""
    item: str | None = None
    """What the rig's fixture puts up first."""
    pose: Annotated[int, Field(ge=0)] = 0
    """In which of its poses."""
    depth_mm: tuple[float, float] | None = None
    """Distances from the camera in mm between which the object lies."""
    limits: str | None = None
    """File of an expert with other limits than the usual ones."""
    report: bool = True
    """Whether `report.html` is drawn."""
    force: bool = False
    """Whether an existing session is replaced."""
    allow: tuple[ConfirmationRequired, ...] = ()
    """What is agreed to in advance; from this computer alone."""
    rig: str | None = None
    """What messages and records call the rig's file; by default as the service was started with it."""
    folder: str | None = None
    """Folder that file names are relative to, from this computer alone; by default the service's."""

    def check_remote(self) -> None:
        """Refuse what only this computer's user may ask for."""
        if self.folder is not None or self.allow:
            name = "folder" if self.folder is not None else "allow"
            raise ConfigError(f"order: '{name}' is for orders from the service's own computer; leave it out")
        for name in ("plan", "calibration", "out", "limits"):
            value = getattr(self, name)
            if isinstance(value, str) and (value.startswith(".") or not is_portable_name(value)):
                raise ConfigError(
                    f"order: '{name}' is '{value}': from another computer it is a name in the service's "
                    "folder, without / \\ : and other signs that Windows does not allow"
                )


class ScanStatus(Document):
    """What is known of a scan."""

    id: int
    """Its number."""
    state: ScanState = ScanState.QUEUED
    """How far it is."""
    version: int = 0
    """Greater each time that anything changes while the service runs."""
    ordered_s: float
    """When it was ordered, in s since 1970."""
    out: str | None = None
    """Folder of the session."""
    stage: str | None = None
    """What is being done."""
    progress: float = 0.0
    """Share of it that is done."""
    messages: tuple[str, ...] = ()
    """What the operator should know."""
    verdict: str | None = None
    """Whether to believe the points."""
    points: int | None = None
    """How many there are."""
    sentence: str | None = None
    """The verdict in one sentence."""
    result: dict[str, Any] | None = None
    """What `fpplab scan --json` prints."""
    error: dict[str, Any] | None = None
    """Why there are no usable points, with the exit code that `fpplab scan` has."""
