"""The example drivers, written by the how-to alone, pass the conformance suite in few lines."""

import shutil
from pathlib import Path

import pytest

from tests.docs.test_write_a_driver import ROOT, count, run_suite

DRIVERS = ROOT / "examples" / "drivers"
LONGEST = 100
CAMERA_RIG = """name: A Raspberry Pi's camera
bench: {backend: "tests.docs.small_sdks:PiBench"}
camera: {backend: "raspberry_camera:RaspberryCamera", number: 0, bits: 10}
projector: {backend: "tests.conformance.reference:ReferenceProjector"}
"""
STAGE_RIG = """name: A turntable
bench: {backend: "tests.conformance.reference:ReferenceBench"}
camera: {backend: "tests.conformance.reference:ReferenceCamera"}
projector: {backend: "tests.conformance.reference:ReferenceProjector"}
stage: {backend: "rotary_stage:RotaryStage", serial: "55000001"}
"""


@pytest.mark.parametrize("name", ["raspberry_camera", "rotary_stage"])
def test_they_are_short(name: str) -> None:
    assert len((DRIVERS / f"{name}.py").read_text(encoding="utf-8").splitlines()) < LONGEST


def folder_with(folder: Path, name: str) -> Path:
    (folder / "picamera2.py").write_text("from tests.docs.small_sdks import Picamera2\n", encoding="utf-8")
    package = folder / "pylablib" / "devices"
    package.mkdir(parents=True)
    package.parent.joinpath("__init__.py").touch()
    (package / "__init__.py").write_text("from tests.docs.small_sdks import Thorlabs\n", encoding="utf-8")
    shutil.copy(DRIVERS / f"{name}.py", folder)
    return folder


@pytest.mark.whole
def test_the_camera_passes(tmp_path: Path) -> None:
    done = run_suite(folder_with(tmp_path, "raspberry_camera"), "", CAMERA_RIG, "tests/conformance")
    assert done.returncode == 0, done.stdout
    assert count(done.stdout, "passed") > 60, done.stdout


@pytest.mark.whole
def test_the_turntable_passes(tmp_path: Path) -> None:
    done = run_suite(folder_with(tmp_path, "rotary_stage"), "", STAGE_RIG, "tests/conformance/test_stage.py")
    assert done.returncode == 0, done.stdout
    assert count(done.stdout, "passed") == 8, done.stdout
