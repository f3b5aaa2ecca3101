"""A display projector, a camera behind the kernel's UVC driver and a stage measure a virtual scene."""

from __future__ import annotations

from pathlib import Path

from tests.drivers.three_devices import check_card
from tests.vm.uvc_bench import LINK


def test_a_card_is_where_it_is_from_wherever_the_stage_stands(tmp_path: Path) -> None:
    check_card(tmp_path, "tests.vm.screen_bench:ScreenBench", str(LINK))
