"""The notebooks run from top to bottom on what the demonstration leaves, and hold no outputs."""

import os
import re
from pathlib import Path
from typing import Any

import pytest

from tests.support.commands import ROOT, Demo

NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


@pytest.mark.whole
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_a_notebook_without_outputs(path: Path) -> None:
    import nbformat  # takes seconds

    book = nbformat.read(path, as_version=4)
    nbformat.validate(book)
    assert book.cells[0].cell_type == "markdown"
    assert [cell.outputs for cell in book.cells if cell.cell_type == "code" and cell.outputs] == []
    assert path.name in (ROOT / "examples" / "README.md").read_text(encoding="utf-8")


def run(name: str, demo: Path | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What the cells of code show last, as text and as HTML."""
    import nbformat
    from nbclient import NotebookClient

    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))
    monkeypatch.setenv("FPPLAB_DEMO", str(demo))
    monkeypatch.setenv("JUPYTER_PLATFORM_DIRS", "1")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    book = nbformat.read(ROOT / "examples" / name, as_version=4)
    NotebookClient(book, timeout=300, resources={"metadata": {"path": tmp_path}}).execute()
    said = [out for cell in book.cells for out in cell.get("outputs", []) if out.output_type == "stream"]
    assert said == []
    results = [out.data for cell in book.cells for out in cell.get("outputs", []) if "data" in out]
    assert not list(tmp_path.glob("*.ipynb"))
    return [data for data in results if not data["text/plain"].startswith("<Figure")]


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_from_session_to_error(demo: Demo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results = run("from_session_to_error.ipynb", demo.folder, tmp_path, monkeypatch)
    session, decoded, calibration, cloud, found, mesh, depth = results
    scan = next(s for s in demo.answer["scans"] if s["artefact"] == "pyramid")
    assert f"<Comparison: {scan['surface_smcd_um']:.1f} µm surface SMCD" in found["text/plain"]
    assert f"{scan['points']:,}" in cloud["text/html"]
    for shown, title in ((session, "Session"), (decoded, "Decoded"), (calibration, "Calibration")):
        assert f"<b>{title}</b>" in shown["text/html"]
    assert mesh["text/plain"].startswith(f"'{scan['points']} corners")
    assert 300.0 < float(depth["text/plain"]) < 600.0


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_plans_and_noise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, ratio, slope = run("plans_and_noise.ipynb", None, tmp_path, monkeypatch)
    ratios = [float(word) for word in re.findall(r"\d\.\d*", ratio["text/plain"])]
    assert all(abs(one - 1.0) < 0.1 for one in ratios), ratios
    assert float(slope["text/plain"]) == pytest.approx(-1.0, abs=0.1)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_calibration(demo: Demo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, _, error, sigmas, _ = run("a_calibration.ipynb", demo.folder, tmp_path, monkeypatch)
    assert float(error["text/plain"]) < 1e-6
    assert "'camera.fx'" in sigmas["text/plain"]
