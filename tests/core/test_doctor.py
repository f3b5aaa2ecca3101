"""`fpplab doctor`: each thing it looks at, as it should be and not."""

import time
from importlib import metadata
from pathlib import Path

import pytest

from fpplab.core import doctor
from fpplab.core.doctor import DoctorFinding
from fpplab.core.extras import EXTRAS
from tests.support.commands import Command


def test_it_answers_with_checks_and_versions(fpplab: Command, tmp_path: Path) -> None:
    done = fpplab("doctor", tmp_path, "--json")
    answer = done.json
    assert done.code == (0 if answer["ok"] else 3)
    assert answer["ok"] == all(check["state"] != "wrong" for check in answer["checks"])
    names = [check["name"] for check in answer["checks"]]
    assert names[: 1 + len(EXTRAS)] == ["packages", *EXTRAS]
    assert {str(tmp_path), "graphics", "disk", "permissions"} <= {*names}
    assert answer["versions"]["numpy"] == metadata.version("numpy")
    assert answer["versions"]["fpplab"] == fpplab("--version").out.split()[1]
    assert list(tmp_path.iterdir()) == []


def test_a_missing_package_of_the_core_is_wrong_and_an_extra_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = ["numpy<2,>=1.26", "none-such>=1", "rerun-sdk>=1; extra == 'viewer'", "ruff; extra == 'dev'"]
    monkeypatch.setattr(metadata, "requires", lambda name: lines)
    monkeypatch.setattr(doctor, "find_spec", lambda name: None if name == "rerun" else name)
    core, *extras = doctor.check_packages()
    assert (core.state, core.seen) == ("wrong", "without none-such")
    viewer = DoctorFinding("viewer", "absent", "without rerun", "pip install 'fpplab[viewer]'")
    assert [one for one in extras if one.state != "ok"] == [viewer]
    assert {*doctor.installed_versions()} == {"fpplab", "python", "platform", "numpy", "rerun-sdk"}


def test_libraries_are_those_of_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "find_spec", lambda name: name if name == "bpy" else None)
    monkeypatch.setattr(doctor, "missing", lambda libraries: ["libgl1", "libsm6"])
    (blender,) = doctor.check_libraries()
    assert blender == DoctorFinding(
        "Blender's libraries", "wrong", "without libgl1, libsm6", "sudo apt-get install libgl1 libsm6"
    )
    monkeypatch.setattr(doctor, "missing", lambda libraries: [])
    assert [one.state for one in doctor.check_libraries()] == ["ok"]


def test_other_systems_need_no_libraries_of_debian(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "LINUX", False)
    assert doctor.check_libraries() == []


def test_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "cache_directory", lambda: tmp_path / "cache" / "fpplab")
    usage = [doctor.LIMITS.min_free_bytes, doctor.LIMITS.min_free_bytes - 1, doctor.LIMITS.min_free_bytes]
    free = [type("Usage", (), {"free": n}) for n in usage]
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda path: free.pop(0))
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: path != tmp_path / "x")
    (tmp_path / "x").mkdir()
    found = doctor.check_folders([tmp_path, tmp_path / "cache" / "fpplab", tmp_path, tmp_path / "x"])
    assert [(one.name, one.state) for one in found] == [
        (str(tmp_path), "ok"),
        (str(tmp_path / "cache" / "fpplab"), "wrong"),
        (str(tmp_path / "x"), "wrong"),
    ]


def test_graphics(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    version = tmp_path / "version"
    assert doctor.check_graphics(tmp_path, version).state == "absent"
    (tmp_path / "renderD128").touch()
    version.write_text("NVRM version: NVIDIA UNIX x86_64 Kernel Module  550.54.14  Thu Feb 22\n")
    seen = doctor.check_graphics(tmp_path, version)
    assert (seen.state, seen.seen) == ("ok", f"{tmp_path / 'renderD128'}, NVIDIA's driver 550.54.14")
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: False)
    closed = doctor.check_graphics(tmp_path, version)
    assert closed.state == "wrong"
    assert "usermod -aG render" in closed.remedy


def test_the_disk_is_measured_and_not_its_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = 0.2
    monkeypatch.setattr(doctor.os, "fsync", lambda file: time.sleep(slow))
    seen = doctor.check_disk(tmp_path, 1 << 20).seen
    assert float(seen.split()[-3]) <= (1 << 20) / 1e6 / slow


def test_the_disk_is_measured_and_judged(tmp_path: Path) -> None:
    assert doctor.check_disk(tmp_path, 1 << 20).seen.endswith(" MB/s written")
    assert list(tmp_path.iterdir()) == []
    assert doctor.check_disk(tmp_path / "none", 1 << 20).state == "wrong"
    assert doctor.disk_speed_finding(tmp_path, doctor.LIMITS.min_bytes_per_s).state == "ok"
    slow = doctor.disk_speed_finding(tmp_path, doctor.LIMITS.min_bytes_per_s - 1.0)
    assert (slow.state, slow.seen) == ("wrong", f"{tmp_path}: 50 MB/s written")
