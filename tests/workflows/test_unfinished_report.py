"""A reconstruction that was killed between cloud and report is run again without `--force`."""

from pathlib import Path
from typing import Any

import pytest

from fpplab.core.errors import ConfigError
from fpplab.report.page import begin_page, is_report
from fpplab.workflows.reconstruct import ReconstructionRequest, check_output


def test_a_cloud_whose_report_was_not_drawn_is_replaced(tmp_path: Path) -> None:
    nothing: Any = None
    cloud, page = tmp_path / "cloud.ply", tmp_path / "cloud.html"
    request = ReconstructionRequest(nothing, nothing, cloud)
    begin_page(page)
    assert is_report(page)
    check_output(request)
    cloud.touch()
    check_output(request)
    page.unlink()
    with pytest.raises(ConfigError, match=r"cloud\.ply: exists already"):
        check_output(request)
    page.write_text('<meta name="generator" content="fpplab">')
    with pytest.raises(ConfigError, match=r"cloud\.ply: exists already"):
        check_output(request)
