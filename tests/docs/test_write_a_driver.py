"""The how-to's cameras, taken from its page, pass the conformance suite; worse ones do not."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from docs.generate.pages import blocks
from fpplab.devices.backends import load_backend

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "write-a-driver.md"
LONGEST = 80
ALLOWED = "acme_camera,raspberry_camera,rotary_stage"
ALL, CAMERA_ALONE = "tests/conformance", "tests/conformance/test_camera.py"
WITHOUT_LIGHT = ("-m", "not light")
BENCH = """bench: {backend: "tests.docs.acme:AcmeBench"}
projector: {backend: "tests.conformance.reference:ReferenceProjector"}
"""
"""In place of the page's projector: what the emulated camera looks at."""


def texts(language: str) -> list[str]:
    return [block.text for block in blocks(PAGE) if block.language == language]


def rig_file(name: str) -> str:
    (found,) = (block.text for block in blocks(PAGE) if block.file_name == name)
    return found


def camera() -> str:
    """The page's file with both classes."""
    return "\n\n".join(texts("python"))


def emulated(triggered: bool) -> str:
    """The page's rig file with an emulated bench."""
    mine = re.sub(r"projector: .*\n", BENCH, rig_file("rig_mine.yaml"))
    return mine.replace(":AcmeCamera", ":TriggeredAcmeCamera") if triggered else mine


def run_suite(folder: Path, code: str, rig: str, *words: str) -> subprocess.CompletedProcess[str]:
    (folder / "acme_camera.py").write_text(code, encoding="utf-8")
    (folder / "acme.py").write_text("from tests.docs.acme import *\n", encoding="utf-8")
    (folder / "rig.yaml").write_text(rig, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", *words, "-q", "-p", "no:cacheprovider"]
    command += ["--rig", str(folder / "rig.yaml")]
    path = os.pathsep.join(map(str, (folder, ROOT)))
    environment = {**os.environ, "PYTHONPATH": path, "FPPLAB_ALLOW_BACKEND": ALLOWED}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


def count(output: str, *outcomes: str) -> int:
    return sum(int(n) for outcome in outcomes for n in re.findall(rf"(\d+) {outcome}", output))


def told() -> list[int]:
    """How many tests the page promises: of the camera alone, and of camera and projector."""
    return [int(n) for n in re.findall(r"These are (\d+) tests", PAGE.read_text(encoding="utf-8"))]


def test_the_page_is_a_whole_camera_in_few_lines() -> None:
    assert len(texts("python")[0].splitlines()) < LONGEST


def test_the_projector_of_the_page_is_accepted_as_it_stands() -> None:
    section = yaml.safe_load(rig_file("rig_mine.yaml"))["projector"]
    backend = load_backend(section.pop("backend"), "rig_mine.yaml", "projector")
    assert backend("projector", section).state == "closed"


@pytest.mark.nightly
def test_the_camera_alone_passes_without_light(tmp_path: Path) -> None:
    done = run_suite(tmp_path, camera(), rig_file("rig_alone.yaml"), CAMERA_ALONE, *WITHOUT_LIGHT)
    assert done.returncode == 0, done.stdout
    assert count(done.stdout, "passed", "skipped") == told()[0], done.stdout
    (shown,) = re.findall(r"`(\d+ passed, [^`]*)`", PAGE.read_text(encoding="utf-8"))
    assert shown in done.stdout


@pytest.mark.whole
@pytest.mark.parametrize("triggered", [False, True], ids=["software trigger", "hardware trigger"])
def test_the_cameras_of_the_page_pass_the_conformance_suite(tmp_path: Path, triggered: bool) -> None:
    done = run_suite(tmp_path, camera(), emulated(triggered), ALL)
    assert done.returncode == 0, done.stdout
    assert count(done.stdout, "passed", "skipped") == told()[1], done.stdout
    assert count(done.stdout, "skipped") == 1 + (not triggered), done.stdout  # its frames take no time


@pytest.mark.nightly
def test_exposures_in_microseconds_end_the_run(tmp_path: Path) -> None:
    code = camera().replace("(least_us / 1e6, most_us / 1e6)", "(least_us, most_us)")
    done = run_suite(tmp_path, code, emulated(triggered=False), ALL)
    assert done.returncode == 1
    assert "CameraCaps.exposure_s begins at 100 s; it is in seconds, not in µs" in done.stdout
    assert count(done.stdout, "passed", "failed", "error") == 1, done.stdout


@pytest.mark.nightly
def test_a_dark_picture_is_told_with_its_exposure(tmp_path: Path) -> None:
    code = (
        camera().replace("bits=(8, 12)", "bits=(8, 16)").replace("else np.uint16)", "else np.uint16) // 50")
    )
    done = run_suite(tmp_path, code, emulated(triggered=False), CAMERA_ALONE, "-k", "what_was_configured")
    assert done.returncode == 1
    assert re.search(r"white is at 1\.\d% of full scale at 20 ms with 8 bits: see light", done.stdout), (
        done.stdout
    )


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("good", "bad", "noticed_by"),
    [
        (
            "np.array(received.pixels, np.uint8 if self._applied.bits == 8 else np.uint16)",
            "received.pixels",
            "frames_are_what_was_configured",
        ),
        ("received.number - self._first", "received.number", "frames_are_what_was_configured"),
        ("received.number - self._first", "self._taken", "lost_on_the_link"),
        ("self._is_wired and not self._sdk.is_ready()", "False", "a_triggered_plan"),
        ("return self._applied\n\n    def _arm", "return settings\n\n    def _arm", "settings_are_read_back"),
        ("super()._setup(options, shared)", "pass", "unknown_key"),
    ],
    ids=["no copy", "the index goes on", "own numbers", "not ready", "not read back", "unknown keys"],
)
def test_a_worse_camera_does_not(tmp_path: Path, good: str, bad: str, noticed_by: str) -> None:
    assert camera().count(good) == 1
    code = camera().replace(good, bad)
    done = run_suite(tmp_path, code, emulated(triggered=True), ALL, "-k", noticed_by)
    assert done.returncode == 1, done.stdout


ONE_LATE = """    def _one_late(self, pixels):
        before, self._kept = getattr(self, "_kept", pixels), pixels.copy()
        return before

"""


@pytest.mark.whole
@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        (
            {
                "np.array(received.pixels, ": "np.array(self._one_late(received.pixels), ",
                "    def _stop(self)": ONE_LATE + "    def _stop(self)",
            },
            "frame 1 after `configure` still has the exposure from before: it was exposed earlier",
        ),
        (
            {
                'self._sdk.set("exposure_us", settings.exposure_s * 1e6)': "pass",
                'read("exposure_us") / 1e6, read("gain_db"), int(read("bits"))': "settings.exposure_s, "
                'read("gain_db"), settings.bits',
            },
            "the contrast is 1.00 times as high: `_configure` must give back what the device reads",
        ),
        (
            {"else np.uint16)  # a copy": "else np.uint16) << 4 * (self._applied.bits == 12)"},
            "has levels of more than 12 bits; its pixels are left-justified: the driver must shift them",
        ),
        (
            {"super()._setup(options, shared)": "pass"},
            "a key that does not exist was accepted: end `_setup` with `super()._setup(options, shared)`",
        ),
        (
            {'CameraSettings(read("exposure_us") / 1e6': 'CameraSettings(read("exposure_us")'},
            "`_configure` gives the exposure in µs; it is in s; fix the driver",
        ),
    ],
    ids=["stale", "lying", "left-justified", "swallowed keys", "µs for s"],
)
def test_the_camera_alone_tells_what_is_wrong(
    tmp_path: Path, changes: dict[str, str], complaint: str
) -> None:
    code = camera()
    for good, bad in changes.items():
        assert code.count(good) == 1, good
        code = code.replace(good, bad)
    rig = emulated(triggered=False).replace("AcmeBench", "AcmeRoom")
    done = run_suite(tmp_path, code, rig, CAMERA_ALONE, *WITHOUT_LIGHT)
    assert done.returncode == 1
    assert complaint in re.sub(r"\s*\nE\s+", " ", done.stdout), done.stdout


@pytest.mark.whole
def test_the_package_of_the_page_announces_its_camera(tmp_path: Path) -> None:
    source, installed = tmp_path / "source", tmp_path / "installed"
    source.mkdir()
    (source / "acme_camera.py").write_text(camera(), encoding="utf-8")
    (source / "pyproject.toml").write_text(texts("toml")[0], encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-build-isolation", "--no-deps"]
    subprocess.run([*pip, "--no-index", "--target", str(installed), str(source)], check=True)
    (installed / "acme.py").touch()
    (name,) = re.findall(r"camera: \{backend: (\w+), serial", PAGE.read_text(encoding="utf-8"))
    load = f"from fpplab.devices.backends import load_backend; print(load_backend({name!r}, 'rig', 'camera'))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (installed, ROOT)))}
    environment.pop("FPPLAB_ALLOW_BACKEND", None)
    done = subprocess.run(
        [sys.executable, "-c", load], env=environment, capture_output=True, text=True, check=False
    )
    assert "acme_camera.AcmeCamera" in done.stdout, done.stderr
