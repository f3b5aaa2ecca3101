"""Each script of the gallery shows the fault that it is named after."""

import re

import pytest

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
