"""A display projector, a camera behind the kernel's UVC driver and a stage measure a virtual scene."""

from pathlib import Path

import pytest

from drivers.display import window
from drivers.stage_grbl import device, wire
from fpplab.acquisition import acquire
from tests.drivers.three_devices import check_card
from tests.vm.uvc_bench import LINK

WAITS = (
    (window, "START_S"),
    (window, "SHOW_S"),
    (window, "STOP_S"),
    (device, "ANSWER_S"),
    (device, "START_S"),
    (wire, "ANSWER_S"),
    (acquire, "READ_TIMEOUT_S"),
)
SLOWER = 8
"""Than a computer that the drivers' limits are for: the processor is emulated, and shares a core."""


@pytest.mark.timeout(1200)
def test_a_card_is_where_it_is_from_wherever_the_stage_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, name in WAITS:
        monkeypatch.setattr(module, name, SLOWER * getattr(module, name))
    check_card(tmp_path, "tests.vm.screen_bench:ScreenBench", str(LINK))
