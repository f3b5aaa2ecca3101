"""Points that another program located: what is in a table comes in, and what is wrong with one is named."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from fpplab.calibration.model import Calibration
from fpplab.characterisation import Observation
from fpplab.characterisation.point_lists import PointListSource, load_point_list
from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.core.errors import DataError
from fpplab.core.geometry import Pinhole
from tests.support.commands import Command
from tests.support.rigs import BOARD, CAMERA, PAIR, observed, poses, values

# Its picture holds the whole board in all poses.
PROJECTOR = Pinhole.from_focal((912, 1140), (900, 1800), (450, 300), (-0.05, 0.02, 0, 0, 0), Lattice.DIAMOND)
PIXELS = ["camera_u", "camera_v", "projector_u", "projector_v"]
Row = list[object]


def table_of(
    observations: Sequence[Observation], path: Path, origin: str = "id", separator: str = ","
) -> Path:
    places = BOARD.points() - (BOARD.points()[0] if origin == "first point" else 0.0)
    names = ["id"] if origin == "id" else ["x_mm", "y_mm"]
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream, delimiter=separator)
        writer.writerow(["pose", *names, *PIXELS])
        for one in observations:
            for k, pixels in zip(one.ids, np.hstack([one.camera_px, one.projector_px]), strict=True):
                board: Row = [k] if origin == "id" else [*np.round(places[k, :2], 3)]
                writer.writerow([one.name, *board, *pixels])
    return path


def source(path: Path) -> PointListSource:
    return PointListSource(path, CAMERA.size, PROJECTOR.size, PROJECTOR.lattice)


@pytest.mark.parametrize(
    ("origin", "separator"),
    [("id", ","), ("centre", ";"), ("first point", "\t")],
    ids=["id", "centre", "first"],
)
def test_points_of_a_table_are_those_of_the_poses(origin: str, separator: str, tmp_path: Path) -> None:
    expected = observed(poses(3), PROJECTOR, 0.05)
    loaded = load_point_list(source(table_of(expected, tmp_path / "p.csv", origin, separator)), BOARD)
    for one, other in zip(loaded, expected, strict=True):
        assert one.name == other.name
        for name in ("ids", "camera_px", "projector_px"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.whole
def test_a_rig_is_characterised_from_points_alone(fpplab: Command, tmp_path: Path) -> None:
    table = table_of(observed(poses(8), PROJECTOR, 0.05), tmp_path / "corners.csv")
    target, out = tmp_path / "target.yaml", tmp_path / "calibration.yaml"
    target.write_text(config.dump(BOARD))
    call = ["characterise", "--points", table, "--target", target, "--out", out, "--json"]
    sizes = ["--camera-size", *CAMERA.size, "--projector-size", *PROJECTOR.size]
    done = fpplab(*call, *sizes, "--lattice", "diamond")
    assert done.code == 0, done.err
    assert done.json["unverified"] == ["how the points were located: there are no frames to check"]
    assert str(table) in done.json["provenance"]["session"]
    calibration = Calibration.load(out)
    expected = values(Calibration(CAMERA, PROJECTOR, PAIR, {}))
    assert calibration.uncertainty is not None
    sigma = calibration.uncertainty.sigma
    for name, value in values(calibration).items():
        assert abs(value - expected[name]) < 4 * sigma[name], name
    missing = fpplab(*call, *sizes[:3])
    assert (missing.code, missing.json["error"]) == (
        2, "--projector-size is missing; a table of points does not say it",
    )  # fmt: skip


def _cell(row: int, column: str, text: str) -> Callable[[list[Row]], list[Row]]:
    def change(rows: list[Row]) -> list[Row]:
        rows[row][rows[0].index(column)] = text
        return rows

    return change


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda rows: [], "is empty"),
        (lambda rows: rows[:1], "names columns, but has no points"),
        (lambda rows: [rows[0][1:], *rows[1:]], "its first row names the columns id, camera_u"),
        (lambda rows: [*rows[:4], rows[4][:-1], *rows[5:]], "row 5 has 5 values for 6 columns"),
        (lambda rows: [*rows, rows[7]], "row 158 gives point 6 of pose pose_0 again"),
        (_cell(3, "camera_u", "12,5"), "'camera_u' in row 4 is '12,5'; a number with a decimal point"),
        (_cell(3, "camera_u", "nan"), "'camera_u' in row 4 is 'nan'"),
        (_cell(2, "id", "52"), "'id' in row 3 is '52'; the board's points are 0 to 51"),
        (
            _cell(2, "projector_v", "2000"),
            "row 3 has the point .* 2000 in the projector, which has 912 x 1140",
        ),
    ],
)
def test_what_is_wrong_with_a_table_is_named(
    change: Callable[[list[Row]], list[Row]], sentence: str, tmp_path: Path
) -> None:
    path = table_of(observed(poses(3), PROJECTOR), tmp_path / "p.csv")
    with path.open(newline="") as stream:
        rows: list[Row] = [list(row) for row in csv.reader(stream)]
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(change(rows))
    with pytest.raises(DataError, match=sentence):
        load_point_list(source(path), BOARD)


def test_points_of_another_board_are_refused(tmp_path: Path) -> None:
    path = table_of(observed(poses(3), PROJECTOR), tmp_path / "p.csv", "centre")
    other = BOARD.model_copy(update={"spacing_mm": tuple(1.2 * s for s in BOARD.spacing_mm)})
    with pytest.raises(DataError, match="where the target file has none"):
        load_point_list(source(path), other)
