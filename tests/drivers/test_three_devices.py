"""A display projector, a video camera and a stage measure a virtual scene; tests/vm does so with a kernel."""

from pathlib import Path

import pytest

from tests.drivers.three_devices import check_card

pytestmark = pytest.mark.whole


def test_a_card_is_where_it_is_from_wherever_the_stage_stands(tmp_path: Path) -> None:
    check_card(tmp_path, "tests.drivers.three_devices:WithoutKernelBench", "/dev/video0")
