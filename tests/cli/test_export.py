"""`fpplab export`: which kind of file becomes which, and what is refused."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from fpplab.cli.every import app
from fpplab.clouds import Cloud, load_cloud, save_cloud
from fpplab.core.errors import FppError
from tests.calibration.examples import calibration

CLOUD = Cloud(
    np.array([[0, 0, 400], [1, 0, 400], [0, 1, 400]], np.float32),
    np.array([[0, 0], [1, 0], [0, 1]], np.int32),
    (2, 2),
)
ANSWER = {"points": 3, "scans": [{"artefact": "steps", "lengths": [{"name": "a"}, {"name": "b"}]}]}


def export(*words: object) -> dict[str, Any]:
    done = CliRunner().invoke(app, ["export", *map(str, words), "--json"])
    if done.exception:
        raise done.exception
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    save_cloud(CLOUD, tmp_path / "scan" / "cloud.ply")
    return tmp_path / "scan" / "cloud.ply"


@pytest.fixture
def answer(tmp_path: Path) -> Path:
    path = tmp_path / "answer.json"
    path.write_text(json.dumps(ANSWER), encoding="utf-8")
    return path


def test_a_session_means_its_cloud(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "points.npz"
    assert export(cloud.parent, "--out", out) == {"file": str(out), "points": 3}
    np.testing.assert_array_equal(load_cloud(out).points, CLOUD.points)


def test_a_calibration_by_its_layout(tmp_path: Path) -> None:
    source = tmp_path / "calibration.yaml"
    calibration().save(source)
    assert export(source, "--out", tmp_path / "c.xml")["layout"] == "opencv"
    assert export(source, "--out", tmp_path / "s.xml", "--layout", "slstudio")["layout"] == "slstudio"
    assert "<Kc " in (tmp_path / "s.xml").read_text(encoding="utf-8")
    assert export(source, "--out", tmp_path / "ros", "--layout", "ros")["layout"] == "ros"
    assert sorted(path.name for path in (tmp_path / "ros").iterdir()) == [
        "camera.yaml",
        "projector.yaml",
        "transform.yaml",
    ]


def test_tables_of_an_answer(answer: Path, tmp_path: Path) -> None:
    found = export(answer, "--out", tmp_path / "tables")
    assert found["tables"] == {"summary": 1, "scans": 1, "scans.lengths": 2}
    assert sorted(path.name for path in (tmp_path / "tables").iterdir()) == [
        "scans.csv",
        "scans.lengths.csv",
        "summary.csv",
    ]
    one = tmp_path / "one.csv"
    assert export(answer, "--out", one, "--table", "scans.lengths")["tables"] == {"scans.lengths": 2}
    with one.open(encoding="utf-8", newline="") as stream:
        assert [*csv.reader(stream)] == [["scans", "name"], ["0", "a"], ["0", "b"]]


def test_names_of_tables_lead_out_of_no_folder(tmp_path: Path) -> None:
    path = tmp_path / "answer.json"
    path.write_text('{"../../x": [{"a": 1}]}', encoding="utf-8")
    export(path, "--out", tmp_path / "deep" / "tables")
    assert [p.name for p in (tmp_path / "deep" / "tables").iterdir()] == [".._.._x.csv"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["none.ply", "--out", "o.csv"], "none.ply: there is no such file"),
        (["scan/cloud.ply", "--out", "o.txt"], "o.txt: its name must end in .ply, .xyz, .npz, .e57"),
        (["scan/cloud.ply", "--out", "scan/cloud.ply"], "scan/cloud.ply: exists already; name another"),
        (["scan/cloud.ply", "--out", "o.csv", "--layout", "ros"], "is no calibration"),
        (["scan/cloud.ply", "--out", "o.csv", "--table", "a"], "is no answer or journal"),
        (["answer.json", "--out", "o.csv"], "holds 3 tables (summary, scans, scans.lengths); choose one"),
        (["answer.json", "--out", "o.csv", "--table", "q"], "--table: 'q' must be one of summary, scans"),
        (["answer.json", "--out", "o.txt"], "o.txt: its name must end in .csv"),
        (["answer.json", "--out", "scan", "--force"], "scan: exists already"),
        (
            ["calibration.yaml", "--out", "o.txt"],
            "o.txt: its name must end in one of .xml, .yml, .json, .mat",
        ),
        (["calibration.yaml", "--out", "o.xml", "--layout", "x"], "layout: 'x' must be one of opencv"),
        (["calibration.yaml", "--out", "o.xml", "--layout", "ros"], "o.xml: for ros, its name must have no"),
        (["calibration.yaml", "--out", "o.xml", "--layout", "matlab"], "its name must end in .mat"),
        (["empty", "--out", "o.csv"], "empty: is an empty folder; expected a session"),
        (["part.stl", "--out", "o.csv"], "part.stl: is empty; expected a cloud (.ply, .xyz, .npz, .csv"),
        (["torn.json", "--out", "o.csv"], "torn.json: is no JSON of fpplab"),
        (["nothing.json", "--out", "o.csv"], "nothing.json: holds no table"),
    ],
)
def test_what_is_refused(
    words: list[str], said: str, cloud: Path, answer: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    calibration().save(Path("calibration.yaml"))
    Path("empty").mkdir()
    Path("part.stl").write_bytes(b"")
    Path("torn.json").write_text('{"a": ', encoding="utf-8")
    Path("nothing.json").write_text("{}", encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(FppError) as caught:
        export(*words)
    assert said in str(caught.value)
    assert caught.value.exit_code in (2, 4)
    assert sorted(tmp_path.rglob("*")) == before


def test_it_is_replaced_by_force(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "points.csv"
    out.write_text("old", encoding="utf-8")
    export(cloud, "--out", out, "--force")
    assert out.read_text(encoding="utf-8").startswith("x_mm,y_mm,z_mm,pixel_u,pixel_v\n0,0,400,0,0\n")
