"""The how-to's camera, taken from its page, passes the conformance suite; a worse one does not."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "write-a-driver.md"
LONGEST = 80
CAMERA_TESTS = "tests/conformance/test_camera.py"
RIG = """name: The how-to's camera at the reference rig
bench: {backend: "tests.docs.acme:AcmeBench"}
camera: {backend: "acme_camera:AcmeCamera", serial: "A-17", bits: 8}
projector: {backend: "tests.conformance.reference:ReferenceProjector"}
"""


def block(language: str) -> str:
    found = re.search(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert found
    return found[1]


def conformance(
    folder: Path, code: str, tests: str = "tests/conformance"
) -> subprocess.CompletedProcess[str]:
    (folder / "acme_camera.py").write_text(code, encoding="utf-8")
    (folder / "acme.py").write_text("from tests.docs.acme import *\n", encoding="utf-8")
    (folder / "rig_mine.yaml").write_text(RIG, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", tests, "-q", "-x", "-m", "not slow"]
    command += ["-p", "no:cacheprovider", "--rig", str(folder / "rig_mine.yaml"), "-k", "not seeded"]
    path = os.pathsep.join(map(str, (folder, ROOT)))
    return subprocess.run(
        command, cwd=ROOT, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False
    )


def test_the_page_is_a_whole_camera_in_few_lines() -> None:
    assert len(block("python").splitlines()) < LONGEST
    assert "acme_camera:AcmeCamera" in block("yaml")


def test_the_camera_of_the_page_passes_the_conformance_suite(tmp_path: Path) -> None:
    done = conformance(tmp_path, block("python"))
    assert done.returncode == 0, done.stdout
    assert int(re.findall(r"(\d+) passed", done.stdout)[0]) > 30, done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("good", "bad"),
    [
        ("np.array(buffer, np.uint8 if self._applied.bits == 8 else np.uint16)", "buffer"),
        ("self._count = 0", "self._count = getattr(self, '_count', 0)"),
        ("return self._applied\n\n    def _arm", "return settings\n\n    def _arm"),
    ],
    ids=["no copy", "the index goes on", "not read back"],
)
def test_a_worse_camera_does_not(tmp_path: Path, good: str, bad: str) -> None:
    code = block("python")
    assert code.count(good) == 1
    assert conformance(tmp_path, code.replace(good, bad), CAMERA_TESTS).returncode == 1
