"""Provenance: where a report's figures come from, by what records state; the rest is `NOT_RECORDED`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from fpplab.calibration.model import Calibration, CalibrationOrigin
from fpplab.core.origin import Origin
from fpplab.core.session_names import CALIBRATION, JOURNAL
from fpplab.core.units import readable_bytes
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.plan import Plan
from fpplab.sessions.origin import SessionOrigin, other_devices, session_origin, taken_at
from fpplab.sessions.session import Session

NOT_RECORDED = "not recorded"  # shown where no record states it

LABELS = {
    "rig": "Rig",
    "rig_file": "Rig file",
    "item": "Item on the rig",
    "camera": "Camera",
    "projector": "Projector",
    "stage": "Stage",
    "plan": "Plan",
    "images": "Images",
    "exposure": "Exposure",
    "gain": "Gain",
    "bits": "Bits",
    "depth_range": "Range of depths",
    "taken": "Taken",
    "session": "Session",
    "cloud": "Cloud",
    "true_shape": "True shape",
    "response": "Response",
    "calibration": "Calibration",
    "calibration_made": "Calibration made",
    "calibration_poses": "Its poses taken",
    "calibration_age": "Calibration age",
    "calibration_rms": "Its RMS errors",
    "calibration_devices": "Its devices",
    "host": "Computer that measured",
    "version": "Its program",
    "judged": "Verdict given",
    "written": "Report written",
}


@dataclass(frozen=True)
class Provenance:
    """Where figures come from."""

    values: Mapping[str, str | None]  # by key of `LABELS`; None where it is not recorded

    def rows(self) -> tuple[tuple[str, str], ...]:
        return tuple(
            (label, self.values[key] or NOT_RECORDED) for key, label in LABELS.items() if key in self.values
        )

    def summary(self) -> dict[str, str | None]:
        return {key: self.values[key] for key in LABELS if key in self.values}

    def with_values(self, **more: str | None) -> Provenance:
        return Provenance({**self.values, **more})


def session_provenance(
    session: Session, calibration: Calibration | None = None, file: Path | None = None
) -> Provenance:
    rig, times = session.rig() or {}, taken_at(session)
    origin = session_origin(session.path)
    mounted = rig.get("resolved", {}).get("mounted")
    values: dict[str, str | None] = {
        "rig": rig.get("name"),
        "rig_file": Path(origin.rig_file).name if origin else None,
        **_device_values(rig, origin),
        "plan": plan_description(session.plan),
        "images": str(session.plan.frames),
        **_camera_settings_as_read(session),
        "taken": f"{local_time(times[0])}, in {duration_text(times[1] - times[0])}" if times else None,
        "session": str(session.path),
        **calibration_values(calibration, file, times[0] if times else None, origin),
        "host": origin.host if origin else None,
        "version": f"fpplab {origin.version}" if origin else None,
        **written_now(),
    }
    if mounted:
        values["item"] = f"{mounted['item']}, pose {mounted['pose']}"
    return Provenance(values)


def poses_provenance(
    poses: Sequence[Session], calibration: Calibration, file: Path | None = None
) -> Provenance:
    first = session_provenance(poses[0], calibration, file)
    times = [taken_at(pose) for pose in poses]
    began, ended = ([period[k] for period in times if period] for k in (0, 1))
    is_complete = len(began) == len(poses)
    taken = f"{local_time(min(began))}, in {duration_text(max(ended) - min(began))}" if is_complete else None
    folder = f"{poses[0].path.parent}, {len(poses)} poses"
    return first.with_values(taken=taken, session=folder, images=f"{first.values['images']} of each pose")


def point_list_provenance(points: Path, calibration: Calibration, file: Path) -> Provenance:
    return Provenance(
        {"session": str(points), **calibration_values(calibration, file, None), **written_now()}
    )


def rig_provenance(
    rig: Mapping[str, object],
    origin: SessionOrigin | None,
    plan: Plan,
    *,
    exposure_s: float | None = None,
    calibration: Calibration | None = None,
    file: Path | None = None,
) -> Provenance:
    camera = rig.get("camera")
    section = camera if isinstance(camera, Mapping) else {}
    exposure = plan.exposure_s if exposure_s is None else exposure_s
    values: dict[str, str | None] = {
        "rig": str(rig["name"]),
        "rig_file": Path(origin.rig_file).name if origin else None,
        **_device_values(rig, origin),
        "plan": plan_description(plan),
        "exposure": f"{1e3 * exposure:.4g} ms",
        "gain": f"{section.get('gain_db', 0.0):g} dB",
        "bits": str(plan.bits or section.get("bits", 8)),
        **written_now(),
    }
    if origin is not None:
        values |= {
            "taken": local_time(origin.made),
            "host": origin.host,
            "version": f"fpplab {origin.version}",
        }
    if calibration is not None:
        values |= calibration_values(calibration, file, origin.made if origin else None, origin)
    return Provenance(values)


def described_rig(rig: Rig) -> tuple[dict[str, object], SessionOrigin]:
    return rig.described(), SessionOrigin.of(rig)


def cloud_provenance(cloud: Path, calibration: Calibration | None = None) -> Provenance:
    size, changed = cloud.stat().st_size, datetime.fromtimestamp(cloud.stat().st_mtime).astimezone()
    own: dict[str, str | None] = {"cloud": f"{cloud}, {readable_bytes(size)}, written {local_time(changed)}"}
    if (cloud.parent / JOURNAL).is_file():
        return session_provenance(Session.open(cloud.parent), calibration).with_values(**own)
    unknown = dict.fromkeys(("rig", "camera", "projector", "plan", "exposure", "taken", "host"))
    return Provenance({**unknown, **own, **calibration_values(calibration, None, None), **written_now()})


def source_provenance(
    source: Path, calibration: Calibration | None = None, file: Path | None = None
) -> Provenance:
    adjacent = (source if source.is_dir() else source.parent) / CALIBRATION
    used = calibration or (Calibration.load(adjacent) if adjacent.is_file() else None)
    if source.is_dir():
        return session_provenance(Session.open(source), used, file or adjacent)
    return cloud_provenance(source, used)


def calibration_values(
    calibration: Calibration | None,
    file: Path | None,
    used: datetime | None,
    devices: SessionOrigin | None = None,
) -> dict[str, str | None]:
    if calibration is None:
        return {"calibration": None}
    origin = calibration.origin
    name = origin.file if origin and origin.file else file.name if file else None
    began = (origin.poses_taken or origin.made) if origin else None
    rms = ", ".join(f"{device} {value:.3f} px" for device, value in calibration.rms_px.items())
    return {
        "calibration": name,
        "calibration_made": f"{local_time(origin.made)}, fpplab {origin.version}" if origin else None,
        "calibration_poses": local_time(origin.poses_taken) if origin and origin.poses_taken else None,
        "calibration_age": _age(used - began) if used and began else None,
        "calibration_rms": rms or None,
        "calibration_devices": _compare_devices(origin, devices) if origin else None,
    }


def plan_description(plan: Plan) -> str:
    axes = []
    for axis in plan.axes:
        sets = [each for each in plan.sets if each.coded_axis == axis]
        fringes = sorted((s for s in sets if isinstance(s, FringeSet)), key=lambda each: each.stripes)
        stripes = ", ".join(fringe.short_name for fringe in fringes)
        steps = ", ".join(str(fringe.images) for fringe in fringes)
        parts = [f"{stripes} stripes in {steps} steps"] if fringes else []
        parts += [f"{s.short_name} in {s.images} images" for s in sets if not isinstance(s, FringeSet)]
        guided = ", guided by the geometry" if axis == plan.guided_axis else ""
        axes.append(f"{axis}: {' and '.join(parts)}{guided}")
    corrected = ", corrected for the response" if plan.response else ""
    return f"{'; '.join(axes)}; {plan.unwrapping}; {plan.trigger}{corrected}"


def local_time(when: datetime) -> str:
    return when.astimezone().strftime("%Y-%m-%d %H:%M:%S %Z").strip()


def duration_text(length: timedelta) -> str:
    remaining = length.total_seconds()
    if remaining < 60:
        return f"{remaining:.1f} s"
    parts = []
    for unit, seconds in (("d", 86400), ("h", 3600), ("min", 60), ("s", 1)):
        count, remaining = divmod(remaining, seconds)
        parts.append(f"{count:.0f} {unit}")
    first = next(k for k, part in enumerate(parts) if not part.startswith("0 "))
    return " ".join(parts[first : first + 2])


def written_now() -> dict[str, str | None]:
    now = Origin.now()
    return {"written": f"{local_time(now.made)}, fpplab {now.version}, on {now.host}"}


def _age(length: timedelta) -> str:
    text = duration_text(abs(length))
    return text if length >= timedelta() else f"made {text} after the measurement began"


def _compare_devices(calibration: CalibrationOrigin, measured: SessionOrigin | None) -> str | None:
    devices = [device for device in (calibration.camera, calibration.projector) if device]
    if not devices:
        return None
    text = "; ".join(device.description for device in devices)
    if measured is None:
        return text
    if others := other_devices(calibration, measured):
        return f"{text}; the {' and the '.join(others)} that measured is ANOTHER"
    if not all(device.serial for device in devices):
        return f"{text}; without serial numbers it is unknown whether they are those that measured"
    return f"{text}; the same that measured"


def _device_values(rig: Mapping[str, object], origin: SessionOrigin | None) -> dict[str, str | None]:
    """Model and serial number of each device; sessions of version 0.1.0 have the model alone."""
    resolved = rig.get("resolved")
    recorded = resolved if isinstance(resolved, Mapping) else {}
    values: dict[str, str | None] = {}
    for name in ("camera", "projector", "stage"):
        if origin and name in origin.devices:
            values[name] = origin.devices[name].description
        elif name != "stage":
            model = recorded.get(name, {}).get("model")
            values[name] = f"{model}, serial number {NOT_RECORDED}" if model else None
    return values


def _camera_settings_as_read(session: Session) -> dict[str, str | None]:
    """Exposure, gain and bits as they were read back; of images from elsewhere only the bits are known."""
    if session.is_imported:
        return {"exposure": None, "gain": None, "bits": str(session.bits)}
    records = session.records
    return {
        "exposure": _all_of([f"{1e3 * record.exposure_s:.4g} ms" for record in records]),
        "gain": _all_of([f"{record.gain_db:g} dB" for record in records]),
        "bits": _all_of([str(record.bits) for record in records]),
    }


def _all_of(texts: Sequence[str]) -> str:
    return ", ".join(dict.fromkeys(texts))
