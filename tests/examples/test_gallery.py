"""Each script of the gallery shows the fault that it is named after."""

import itertools
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from docs.generate.pages import DOCS
from docs.generate.running import GALLERY, verdict_of

CAUSES = {
    "good": "good",
    "freeform": "good",
    "camera_out_of_focus": "camera_focus",
    "projector_out_of_focus": "projector_focus",
    "saturated": "saturated",
    "too_dark": "useless",
    "light_of_the_room": "ambient",
    "vibration": "vibration",
    "gloss": "",
    "light_between_walls": "interreflection",
    "response": "response",
    "wrong_orders": "fringe order",
    "moved_projector": "",
    "flying_points": "",
}
"""What the verdict has to say; empty where frames of one axis cannot tell, as the page says."""


def test_the_page_shows_every_script() -> None:
    shown = re.findall(r"generated/gallery/(\w+)\.png", (DOCS / "gallery.md").read_text(encoding="utf-8"))
    assert sorted(shown) == sorted(CAUSES) == [script.stem for script in GALLERY]


@pytest.mark.nightly
@pytest.mark.parametrize("script", GALLERY, ids=lambda script: script.stem)
def test_the_fault_is_named(script: object) -> None:
    said = verdict_of(script)  # type: ignore[arg-type]
    assert CAUSES[script.stem] in said, said  # type: ignore[attr-defined]


def frames_of(path: Path) -> np.ndarray:  # type: ignore[type-arg]
    with Image.open(path) as picture:
        return np.stack([np.asarray(one.convert("RGB"), float) for one in ImageSequence.Iterator(picture)])


def test_the_scan_of_the_readme_shows_its_result_first() -> None:
    frames = frames_of(DOCS / "pictures" / "scan.webp")
    assert len(frames) == 1 + 18
    colours = [np.mean(np.ptp(one, axis=-1) > 40) for one in frames]
    assert min(colours[0], *colours[7:]) > 0.2, "the surface is coloured"
    assert max(colours[1:7]) < 0.02, "there is none by the first fringe set"
    assert all(np.mean(abs(a - b)) > 1 for a, b in itertools.pairwise(frames)), "fringes move"


@pytest.mark.nightly
def test_the_scan_of_the_readme_is_what_its_script_makes(tmp_path: Path) -> None:
    (script,) = (one for one in GALLERY if one.stem == "freeform")
    subprocess.run([sys.executable, str(script), str(tmp_path / "scan.webp")], check=True)
    made, kept = frames_of(tmp_path / "scan.webp"), frames_of(DOCS / "pictures" / "scan.webp")
    assert np.mean(abs(made - kept)) < 2.0
