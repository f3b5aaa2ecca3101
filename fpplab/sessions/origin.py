"""The record of when, where and with which devices a session was begun."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fpplab.calibration.model import Calibration, CalibrationOrigin
from fpplab.core import config
from fpplab.core.errors import CalibrationError
from fpplab.core.files import write_text
from fpplab.core.origin import DeviceIdentity, Origin
from fpplab.core.session_names import ORIGIN
from fpplab.devices.rig import Rig
from fpplab.patterns.plan import Plan
from fpplab.sessions.session import Session


class SessionOrigin(Origin):
    """When, where and with which devices a session was begun.

    It stands apart from the rig's record, by which an interrupted session is recognised: another computer or
    version may complete it.
    """

    rig_file: str
    """The rig file."""
    devices: dict[str, DeviceIdentity]
    """By section of the rig file."""
    temperatures_c: dict[str, float] | None = None
    """Of those that have a thermometer, when the session was begun, in °C."""
    first_frame: int | None = None
    """Number that the first frame has in the simulation that takes it, from which its noise follows; None
    for a bench, and where an earlier version began the session."""

    @classmethod
    def of(cls, rig: Rig, first_frame: int | None = None) -> SessionOrigin:
        opened = {
            "camera": rig.camera,
            "projector": rig.projector,
            "stage": rig.stage,
            "fixture": rig.fixture,
            **rig.stages,
        }
        present = {name: device for name, device in opened.items() if device is not None}
        reported = {name: device.info() for name, device in present.items()}
        read = {name: device.temperature_c for name, device in present.items()}
        temperatures_c = {name: celsius for name, celsius in read.items() if celsius is not None}
        devices = {
            name: DeviceIdentity(model=info.model, serial=info.serial) for name, info in reported.items()
        }
        offset = rig.camera.caps.offset
        devices["camera"] = devices["camera"].model_copy(update={"offset_px": offset})
        return cls.now(
            rig_file=rig.source,
            devices=devices,
            temperatures_c=temperatures_c or None,
            first_frame=first_frame,
        )

    @property
    def camera_offset(self) -> tuple[int, int] | None:
        """Column and row of the sensor where the frames begin; None where it was not recorded."""
        camera = self.devices.get("camera")
        return camera.offset_px if camera else None


def record_origin(folder: Path, rig: Rig, first_frame: int | None = None) -> None:
    if not (folder / ORIGIN).is_file():
        write_text(folder / ORIGIN, config.dump(SessionOrigin.of(rig, first_frame)))


def session_origin(folder: Path) -> SessionOrigin | None:
    path = folder / ORIGIN
    return config.load_document(path, SessionOrigin) if path.is_file() else None


def other_devices(calibration: CalibrationOrigin, measured: SessionOrigin) -> list[str]:
    """List the devices of a measurement that a calibration was not made with, by their serial numbers."""
    made_with = {"camera": calibration.camera, "projector": calibration.projector}
    pairs = [(name, made, measured.devices.get(name)) for name, made in made_with.items()]
    return [
        name
        for name, made, used in pairs
        if made and used and made.serial and used.serial
        if (made.model, made.serial) != (used.model, used.serial)
    ]


def check_region(calibration: Calibration, session: Session) -> bool:
    """Refuse frames of another region of the sensor; tell whether it is known to be the same."""
    made = calibration.origin.camera if calibration.origin else None
    measured = session_origin(session.path)
    stated, shown = made.offset_px if made else None, measured.camera_offset if measured else None
    if stated is None or shown is None:
        return False
    if stated != shown:
        raise CalibrationError(
            f"{session.path}: its frames begin at column {shown[0]}, row {shown[1]} of the sensor, but those "
            f"that the calibration was made from at column {stated[0]}, row {stated[1]}; record the same "
            "region, or characterise with this one"
        )
    return True


def check_stage(calibration: Calibration, plan: Plan, source: Path | str) -> None:
    """Refuse a plan that puts the stage elsewhere than for the calibration: the baseline is another."""
    calibrated_mm = calibration.origin.stage_mm if calibration.origin else None
    if calibrated_mm is not None and plan.stage_mm is not None and calibrated_mm != plan.stage_mm:
        raise CalibrationError(
            f"{source}: puts the stage at {plan.stage_mm:g} mm, but the poses of the calibration were taken "
            f"at {calibrated_mm:g} mm; write 'stage_mm: {calibrated_mm:g}', or characterise at "
            f"{plan.stage_mm:g} mm"
        )


def foreign_calibration(calibration: Calibration, session: Session) -> str | None:
    made, measured = calibration.origin, session_origin(session.path)
    if made is None or measured is None:
        return None
    made_with = {"camera": made.camera, "projector": made.projector}
    clauses = [
        f"the {name} is {measured.devices[name].description}, but the calibration was made with "
        f"{identity.description}"
        for name in other_devices(made, measured)
        if (identity := made_with[name])
    ]
    return "; ".join(clauses) or None


def taken_at(session: Session) -> tuple[datetime, datetime] | None:
    if session.is_imported or not session.records:
        return None
    times = [record.host_time_s for record in session.records]
    return datetime.fromtimestamp(min(times), UTC), datetime.fromtimestamp(max(times), UTC)


def calibration_origin(poses: Sequence[Session]) -> CalibrationOrigin:
    ends = [times[1] for times in map(taken_at, poses) if times]
    devices = [origin.devices if (origin := session_origin(pose.path)) else {} for pose in poses]
    agreed = {
        name: devices[0].get(name)
        if all(of_pose.get(name) == devices[0].get(name) for of_pose in devices)
        else None
        for name in ("camera", "projector")
    }
    stages = {pose.plan.stage_mm for pose in poses}
    stage_mm = stages.pop() if len(stages) == 1 else None
    taken = max(ends).replace(microsecond=0) if len(ends) == len(poses) else None
    by_hand = _settings_by_hand(poses)
    return CalibrationOrigin.now(poses_taken=taken, stage_mm=stage_mm, **agreed, **by_hand)


def _settings_by_hand(poses: Sequence[Session]) -> dict[str, Any]:
    """Give what all poses' rig files state alike of the rig's settings and temperature."""
    stated = [(pose.rig() or {}).get("geometry") or {} for pose in poses]
    names = ("settings", "temperature_c")
    return {
        n: stated[0].get(n) for n in names if all(settings.get(n) == stated[0].get(n) for settings in stated)
    }


def with_confirmation(calibration: Calibration, poses: Sequence[Session]) -> Calibration:
    if calibration.origin is None:
        raise CalibrationError("the calibration does not record when it was made, and cannot be confirmed")
    ends = {pose.path: taken_at(pose) for pose in poses}
    for path, times in ends.items():
        if times is None:
            raise CalibrationError(f"{path}: does not record when it was taken, and cannot confirm anything")
    last = max(times[1] for times in ends.values() if times).replace(microsecond=0)
    now = {"confirmed": last, **_settings_by_hand(poses)}
    return replace(calibration, origin=calibration.origin.model_copy(update=now))
