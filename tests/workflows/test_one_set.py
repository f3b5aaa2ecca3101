"""Sessions of one set of fringes: what `decode` and `reconstruct` write, and what they ask for."""

from pathlib import Path

import numpy as np
import pytest

from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from fpplab.diagnosis import Verdict
from fpplab.phase import Decoded
from fpplab.pipeline.decoding import parse_known
from fpplab.workflows.maps import DecodingRequest, run_decoding
from fpplab.workflows.reconstruct import reconstruct
from tests.phase.test_bent_phases import bent
from tests.reconstruction.test_heights import BASELINE_MM, DISTANCE_MM, DOME, ONE, PERIOD_MM, RIG
from tests.reconstruction.test_heights import recorded as frames_of
from tests.workflows.test_decode import recorded


def session(folder: Path, height_mm: Floats | float, seed: int) -> Path:
    folder.mkdir()
    return recorded(frames_of(height_mm, ONE, seed), folder)


@pytest.mark.whole
def test_heights_over_a_plane_are_written(tmp_path: Path) -> None:
    plane, item = session(tmp_path / "plane", 0.0, 1), session(tmp_path / "item", DOME, 2)
    file = tmp_path / "plane.yaml"
    file.write_text(f"distance_mm: {DISTANCE_MM}\nbaseline_mm: {-BASELINE_MM}\nperiod_mm: {PERIOD_MM}\n")
    out = tmp_path / "maps.npz"
    known = parse_known(["70,50,8.4"])
    result = run_decoding(DecodingRequest(item, out, known=known, reference=plane, plane=file))
    summary = result.summary()
    assert summary["verdict"] == "unverified"
    assert summary["islands"] == {"count": 1, "known": 1}
    assert summary["heights"] == summary["valid"]
    written = Decoded.load(out)
    assert written.height_mm is not None
    assert np.nanmax(np.abs(written.height_mm - DOME)) < 0.3
    with pytest.raises(ConfigError, match="--reference and --plane: one is given without the other"):
        run_decoding(DecodingRequest(item, tmp_path / "other.npz", reference=plane))


@pytest.mark.whole
def test_points_need_a_depth_range_or_a_known_distance(tmp_path: Path) -> None:
    item = session(tmp_path / "item", DOME, 3)
    result = reconstruct(item, RIG, depth_mm=(388.0, 400.0))
    assert result.diagnosis.verdict is Verdict.UNVERIFIED
    assert result.cloud is not None
    assert result.cloud.pixels is not None
    column, row = result.cloud.pixels.T
    assert np.abs(DISTANCE_MM - result.cloud.points[:, 2] - DOME[row, column]).max() < 0.3
    written = tmp_path / "maps.npz"
    decoded = run_decoding(DecodingRequest(item, written))
    assert decoded.summary()["islands"] == {"count": 1, "known": 0}
    assert decoded.diagnosis.reason.startswith("1 of 1 island, with 100% of the pixels")


@pytest.mark.parametrize("option", ["1,2", "1,2,x", "1.5,2,3", ""])
def test_a_known_point_that_is_none_is_refused(option: str) -> None:
    with pytest.raises(ConfigError, match=r"--known is '.*': must be COLUMN,ROW,VALUE, such as"):
        parse_known([option])


def test_a_known_point_is_refused_where_sets_tell_orders(tmp_path: Path) -> None:
    path = recorded(bent([(1, 4), (8, 4), (64, 4)], 1.0, seed=5)[0], tmp_path)
    with pytest.raises(ConfigError, match="--known: is for plans with 'unwrapping: spatial'"):
        run_decoding(DecodingRequest(path, tmp_path / "maps.npz", known=((1, 2, 3.0),)))
