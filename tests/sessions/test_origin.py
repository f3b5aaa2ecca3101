"""Sessions and calibrations record when, where and with which devices they were made."""

from dataclasses import replace
from pathlib import Path

import pytest

from fpplab.calibration.model import Calibration, CalibrationOrigin
from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.origin import DeviceIdentity
from fpplab.core.version import __version__
from fpplab.results.provenance import poses_provenance, session_provenance
from fpplab.sessions.origin import (
    ORIGIN,
    SessionOrigin,
    calibration_origin,
    check_region,
    foreign_calibration,
    other_devices,
    record_origin,
    session_origin,
)
from fpplab.sessions.session import Session
from tests.comparison.test_comparison import CALIBRATION
from tests.support.faulty_rig import formula_rig
from tests.support.recorded import record


def test_the_origin_of_a_session_is_that_of_its_beginning(tmp_path: Path) -> None:
    with formula_rig(None, 3) as rig:
        record_origin(tmp_path, rig)
        first = (tmp_path / ORIGIN).read_text(encoding="utf-8")
        record_origin(tmp_path, rig)
        told = rig.camera.info()
    assert (tmp_path / ORIGIN).read_text(encoding="utf-8") == first
    origin = session_origin(tmp_path)
    assert origin is not None
    assert origin.version == __version__
    assert origin.devices["camera"] == DeviceIdentity(model=told.model, serial=told.serial)
    (tmp_path / ORIGIN).write_text("made: yesterday\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="made"):
        session_origin(tmp_path)


def test_copies_of_a_calibration_tell_its_first_name(tmp_path: Path) -> None:
    made = replace(CALIBRATION, origin=CalibrationOrigin.now())
    made.save(tmp_path / "monday.yaml")
    Calibration.load(tmp_path / "monday.yaml").save(tmp_path / "calibration.yaml")
    copy = Calibration.load(tmp_path / "calibration.yaml").origin
    assert copy is not None
    assert copy.file == "monday.yaml"
    CALIBRATION.save(tmp_path / "old.yaml")
    assert "origin" not in (tmp_path / "old.yaml").read_text(encoding="utf-8")
    assert Calibration.load(tmp_path / "old.yaml").origin is None


def recorded_pose(path: Path, serial: str | None) -> None:
    """A session of a rig that records its serial numbers, or of version 0.1.0."""
    session = record(path)
    (session.path / "rig.yaml").write_text("name: bench\nresolved: {}\n", encoding="utf-8")
    if serial is not None:
        devices = {"camera": DeviceIdentity(model="cam", serial=serial)}
        from fpplab.core import config

        origin = SessionOrigin.now(rig_file="rig.yaml", devices=devices)
        (path / ORIGIN).write_text(config.dump(origin), encoding="utf-8")


def test_a_calibration_names_devices_that_all_poses_agree_on(tmp_path: Path) -> None:
    for name, serial in (("a", "1"), ("b", "1"), ("c", "2"), ("d", None)):
        recorded_pose(tmp_path / name, serial)
    poses = {name: Session.open(tmp_path / name) for name in "abcd"}
    agreed = calibration_origin([poses["a"], poses["b"]])
    assert agreed.camera == DeviceIdentity(model="cam", serial="1")
    assert agreed.projector is None
    assert agreed.poses_taken is not None
    assert agreed.poses_taken.timestamp() == 103  # host time of the last frame
    assert calibration_origin([poses["a"], poses["c"]]).camera is None
    assert calibration_origin([poses["a"], poses["d"]]).camera is None
    whence = poses_provenance(
        [poses["a"], poses["b"]], replace(CALIBRATION, origin=agreed), tmp_path / "c.yaml"
    )
    assert whence.values["calibration"] == "c.yaml"
    assert "2 poses" in (whence.values["session"] or "")


def test_an_exchanged_camera_is_told_and_what_is_missing_is_not_invented(tmp_path: Path) -> None:
    recorded_pose(tmp_path / "new", "2")
    old = CalibrationOrigin.now(camera=DeviceIdentity(model="cam", serial="1"))
    told = session_provenance(Session.open(tmp_path / "new"), replace(CALIBRATION, origin=old)).values
    assert "the camera that measured is ANOTHER" in (told["calibration_devices"] or "")
    assert "after the measurement began" in (told["calibration_age"] or "")  # frames of 1970
    record(tmp_path / "imported")
    bare = session_provenance(Session.open(tmp_path / "imported"), CALIBRATION).values
    for key in ("rig", "rig_file", "camera", "projector", "exposure", "gain", "taken", "host", "version"):
        assert bare[key] is None
    assert bare["calibration_made"] is None


def test_serial_numbers_tell_another_device_and_models_without_one_do_not(tmp_path: Path) -> None:
    one, two, plain = (DeviceIdentity(model="cam", serial=serial) for serial in ("1", "2", ""))
    made = CalibrationOrigin.now(camera=one, projector=plain)

    def differing(camera: DeviceIdentity, projector: DeviceIdentity) -> list[str]:
        devices = {"camera": camera, "projector": projector}
        return other_devices(made, SessionOrigin.now(rig_file="rig.yaml", devices=devices))

    assert differing(one, two) == []
    assert differing(two, plain) == ["camera"]
    assert differing(plain, plain) == []
    recorded_pose(tmp_path / "scan", "2")
    session = Session.open(tmp_path / "scan")
    words = foreign_calibration(replace(CALIBRATION, origin=made), session)
    assert words == "the camera is cam, serial 2, but the calibration was made with cam, serial 1"
    assert foreign_calibration(CALIBRATION, session) is None


def test_frames_of_another_region_of_the_sensor_are_refused(tmp_path: Path) -> None:
    def placed(offset: tuple[int, int] | None) -> DeviceIdentity:
        return DeviceIdentity(model="cam", serial="1", offset_px=offset)

    recorded_pose(tmp_path / "scan", "1")
    session = Session.open(tmp_path / "scan")
    known = replace(CALIBRATION, origin=CalibrationOrigin.now(camera=placed((8, 0))))
    assert not check_region(known, session)  # as of version 0.1, which recorded no region
    for offset, is_known in (((8, 0), True), (None, False)):
        _record_camera(tmp_path / "scan", placed(offset))
        assert check_region(known, session) is is_known
        assert not check_region(CALIBRATION, session)
    _record_camera(tmp_path / "scan", placed((0, 4)))
    assert foreign_calibration(known, session) is None  # the same camera
    with pytest.raises(CalibrationError, match=r"begin at column 0, row 4 .* at column 8, row 0"):
        check_region(known, session)
    known.save(tmp_path / "c.yaml")
    origin = Calibration.load(tmp_path / "c.yaml").origin
    assert origin is not None
    assert origin.camera == placed((8, 0))


def _record_camera(folder: Path, camera: DeviceIdentity) -> None:
    from fpplab.core import config

    origin = SessionOrigin.now(rig_file="rig.yaml", devices={"camera": camera})
    (folder / ORIGIN).write_text(config.dump(origin), encoding="utf-8")
