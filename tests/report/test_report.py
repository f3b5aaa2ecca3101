"""The page is one self-contained file, escaped, readable without images, with only the given sections."""

import base64
import io
from dataclasses import replace
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as Pixels

from fpplab.calibration.model import Calibration
from fpplab.characterisation import Characterisation
from fpplab.characterisation.observation import Observation
from fpplab.clouds import Cloud
from fpplab.comparison import Comparison, FittedScale, MeasuredLength
from fpplab.core.errors import DataError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Region, Response, ResponseLevel
from fpplab.phase import Decoded, Wrapped
from fpplab.report import figures
from fpplab.report.measurements import write_report
from fpplab.report.scan_section import ScanSection
from fpplab.report.uncertainty import shape_sigma_mm, sigma_caption, sigma_maps

SIZE = (64, 48)


class Page(HTMLParser):
    """The page's images, headings, tables' cells and everything that could leave the file."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.images: list[dict[str, str | None]] = []
        self.headings: list[str] = []
        self.cells: list[str] = []
        self.tags: list[str] = []
        self.links: list[str] = []
        self._in = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._in = tag
        if tag == "img":
            self.images.append(dict(attrs))
        self.links += [v or "" for k, v in attrs if k in ("href", "src", "srcset", "data", "action")]

    def handle_endtag(self, tag: str) -> None:
        self._in = ""

    def handle_data(self, data: str) -> None:
        if self._in in ("h1", "h2"):
            self.headings.append(data)
        if self._in in ("td", "th"):
            self.cells.append(data)


def decoded(axes: str = "x") -> Decoded:
    v, u = np.mgrid[0.0 : SIZE[1], 0.0 : SIZE[0]].astype(np.float32)
    empty = np.full_like(u, np.nan)
    maps = [2 * u if "x" in axes else empty, 3 * v if "y" in axes else empty, 50 + u, 0.02 + 0 * u]
    for values in maps:
        values[:10] = np.nan
    return Decoded(*maps)


def cloud() -> Cloud:
    v, u = np.mgrid[10 : SIZE[1], 0 : SIZE[0]]
    points = np.stack([0.5 * u, 0.5 * v, 400 + 0.01 * u], axis=-1).reshape(-1, 3).astype(np.float32)
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.int32)
    sigma = np.full(len(points), 0.0125, np.float32)
    return Cloud(points, pixels, SIZE, sigma_noise_mm=sigma)


def comparison(points: int) -> Comparison:
    distances = np.random.default_rng(2).normal(0, 0.04, points).astype(np.float32)
    return Comparison(
        smcd_um=212.4,
        smcd_floor_um=187.6,
        surface_smcd_um=45.67,
        surface_rms_um=57.89,
        surface_p95_um=110.2,
        completeness=0.934,
        outliers=12,
        visible_share=0.81,
        points=points,
        off_part=0,
        density_per_mm2=200.0,
        outlier_mm=1.0,
        near_mm=0.5,
        restricted=True,
        alignment=None,
        distances_mm=distances,
        counted=np.ones(points, np.bool_),
    )


@pytest.mark.whole
def test_lengths_and_what_contradicts_the_distances_are_shown(tmp_path: Path) -> None:
    lengths = (
        MeasuredLength("step height 1 to 5", 20.0, 20.2, 0.4),
        MeasuredLength("step height 1 to 2", 5.0, None, None),
    )
    found = replace(comparison(len(cloud())), scale=FittedScale(10_000.0, 30.0, 33.0), lengths=lengths)
    write_report(tmp_path / "r.html", "Scan", scans=[replace(scan("steps"), comparison=found)])
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    for said in (
        "+10000 ± 30",
        "20.2000",
        "+200.0",
        "step height 1 to 2",
        "Scale: the cloud is 10000 ± 30 ppm",
    ):
        assert said in page
    assert "Step height 1 to 5: measures 20.2000 mm" in page


def scan(name: str = "pyramid", axes: str = "x", truth: bool = True) -> ScanSection:
    frame = np.random.default_rng(1).integers(0, 200, (SIZE[1], SIZE[0])).astype(np.uint8)
    flat = np.zeros((SIZE[1], SIZE[0]), np.float32)
    wrapped = Wrapped(flat + 1, flat + 50, flat + 100, flat, flat + 200, flat + 1)
    points = cloud()
    return ScanSection(
        name, 36, frame, wrapped, decoded(axes), points, comparison(len(points)) if truth else None
    )


def characterisation() -> Characterisation:
    rng = np.random.default_rng(4)
    device = Pinhole.from_focal(SIZE, (80.0, 81.0), (31.0, 23.0))
    pose = RigidTransform(np.eye(3), np.array([-120.0, 0, 0]))
    calibration = Calibration(device, device, pose, {"camera": 0.0421, "projector": 0.0604, "joint": 0.0511})
    observations = tuple(
        Observation(name, np.arange(9), rng.uniform(5, 40, (9, 2)), rng.uniform(5, 40, (9, 2)))
        for name in ("pose_00", "pose_01", "pose_02")
    )
    residuals = tuple(rng.normal(0, 0.05, (9, 2)) for _ in observations)
    return Characterisation(
        calibration=calibration,
        observations=observations,
        poses=(RigidTransform.identity(),) * 3,
        camera_residuals=residuals,
        projector_residuals=residuals,
        separate_px={"camera": 0.05, "projector": 0.07, "stereo": 0.08},
        leave_one_out_px={"camera": 0.0733, "projector": 0.0844},
        board=np.zeros((9, 3)),
        left_out={"pose_03": "pose_03: the board was not found in the image"},
        sigma={"camera.fx": 0.3},
    )


def response() -> tuple[Response, Any]:
    levels = np.linspace(0, 1, 9)
    fitted = Response(a=0.9, b=0.02, g=2.2, sigma=(0.001, 0.002, 0.003), residual=0.004, levels=9)
    return fitted, np.stack([levels, fitted.apply(levels)], axis=1)


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(
        path,
        "Demonstration <b>1</b>",
        head_facts={"Rig": "Bench & twin"},
        response=response(),
        characterisation=characterisation(),
        scans=[scan("pyramid"), scan("steps", "xy")],
        written_at=datetime(2026, 3, 4, 15, 30, tzinfo=UTC),
    )
    return path


@pytest.mark.whole
def test_the_page_refers_to_nothing_outside_the_file(full: Path) -> None:
    page = Page(full)
    assert not {"link", "iframe", "object", "form"} & set(page.tags)
    inside = ("data:image/png;base64,", "data:text/csv;", "data:application/json;", "#")
    assert all(link.startswith(inside) for link in page.links)
    text = full.read_text(encoding="utf-8")
    assert "url(" not in text
    assert "@import" not in text
    assert "http" not in text.replace("http-equiv", "")


def test_every_image_is_a_png_with_alternative_text(full: Path) -> None:
    page = Page(full)
    # response; poses, two residuals, two coverages, epipolar; seven and eight maps with an error map and a
    # still picture of the points each
    assert len(page.images) == 1 + 6 + 9 + 10
    for image in page.images:
        assert image["alt"]
        data = base64.b64decode((image["src"] or "").split(",")[1], validate=True)
        picture = Pixels.open(io.BytesIO(data))
        assert picture.format == "PNG"
        assert picture.width <= 1600


def test_the_summary_tables_come_first(full: Path) -> None:
    text = full.read_text(encoding="utf-8")
    assert text.index("Surface RMS") < text.index("<img")
    cells = Page(full).cells
    for figure in (
        "57.9",
        "110",
        "45.7",
        "212",
        "188",
        "93.4\u202f%",
        "2\u202f432",
        "0.042",
        "0.060",
        "0.073",
        "0.084",
    ):
        assert figure in cells
    assert "12 (0.493\u202f%)" in cells
    assert "80.0 ± 0.3 / 81.0" in cells


def test_text_is_escaped_and_dated(full: Path) -> None:
    text = full.read_text(encoding="utf-8")
    assert "Demonstration &lt;b&gt;1&lt;/b&gt;" in text
    assert "Bench &amp; twin" in text
    assert "2026-03-04 15:30 UTC" in text


def test_sections_in_their_order(full: Path) -> None:
    assert Page(full).headings[1:] == ["Pyramid", "Steps", "Characterisation", "Response"]
    assert "pose_03: the board was not found in the image" in Page(full).cells


@pytest.mark.whole
def test_a_scan_without_truth_has_its_roughness(tmp_path: Path) -> None:
    path = tmp_path / "scan.html"
    write_report(path, "Scan", scans=[scan(truth=False)])
    page = Page(path)
    assert page.headings[1:] == ["Pyramid"]
    assert len(page.images) == 8
    assert "Roughness in µm" in page.cells
    assert "12.5" in page.cells
    assert "SMCD in µm" not in page.cells


def test_the_uncertainty_caption_explains_common_errors() -> None:
    noise = cloud()
    assert "nothing of its own uncertainty" in sigma_caption(noise)
    both = replace(noise, sigma_calibration_mm=np.full(len(noise), 0.03, np.float32))
    assert "common to all points" in sigma_caption(both)
    assert "and calibration, added in squares, median 32.5 µm" in sigma_caption(both)  # √(12.5² + 30²)
    assert "Shape:" not in sigma_caption(both)
    formed = replace(both, sigma_form_mm=np.full(len(noise), 0.03, np.float32) / 4)
    assert "Shape: noise and form, added in squares, median 14.6 µm" in sigma_caption(formed)
    measured = replace(formed, sigma_phase_error_mm=np.full(len(noise), 0.01, np.float32))
    assert shape_sigma_mm(measured) == pytest.approx(np.full(len(noise), 0.0176777), rel=1e-4)
    assert "Shape: noise, phase error and form, added in squares, median 17.7 µm" in sigma_caption(measured)
    narrow, wide = (Pixels.open(io.BytesIO(sigma_maps(c))).width for c in (noise, both))
    assert wide == pytest.approx(2 * narrow, rel=0.02)


def test_the_uncertainty_caption_tells_why_the_phase_error_is_unknown() -> None:
    def plan(*sets: tuple[int, int]) -> Plan:
        fringes = tuple({"axis": "x", "stripes": stripes, "steps": steps} for stripes, steps in sets)
        return Plan.model_validate({"fringes": fringes, "exposure_s": 0.02})

    pixels, steps = "of the pixels that are sampled", "three steps only"
    for chosen, why, other in (
        (plan((1, 12), (8, 12), (64, 12)), pixels, steps),
        (plan((1, 3), (8, 3)), pixels, steps),
        (plan((1, 3)), steps, pixels),
        (plan((1, 3), (2, 3)), steps, pixels),
    ):
        caption = sigma_caption(cloud(), chosen)
        assert why in caption
        assert other not in caption
    assert pixels in sigma_caption(cloud())
    assert steps in sigma_caption(cloud())


def test_a_cloud_from_elsewhere_has_no_map_of_its_uncertainty(tmp_path: Path) -> None:
    bare = replace(cloud(), sigma_noise_mm=None)
    with pytest.raises(DataError, match="nothing to draw"):
        sigma_maps(bare)
    path = tmp_path / "scan.html"
    write_report(path, "Scan", scans=[replace(scan(truth=False), cloud=bare)])
    assert len(Page(path).images) == 7


@pytest.mark.whole
def test_only_counted_points_are_in_the_error_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []

    def drawn(*given: Any) -> bytes:
        seen.append(given)
        return b""

    monkeypatch.setattr(figures, "error_map", drawn)
    one = scan()
    assert one.comparison is not None
    one.comparison.counted[:5] = False
    write_report(tmp_path / "scan.html", "Scan", scans=[one])
    assert [given[2].sum() for given in seen] == [len(one.cloud) - 5]


def test_a_characterisation_alone(tmp_path: Path) -> None:
    path = tmp_path / "characterisation.html"
    write_report(path, "Characterisation", characterisation=characterisation())
    assert Page(path).headings[1:] == ["Characterisation"]


def test_a_report_is_written_completely_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        write_report(tmp_path / "file" / "report.html", "Scan")
    old = tmp_path / "report.html"
    old.write_text("old")
    unknown = np.full(len(cloud()), np.nan, np.float32)
    broken = replace(scan(truth=False), cloud=replace(cloud(), sigma_noise_mm=unknown))
    with pytest.raises(DataError, match="no measured pixel"):
        write_report(old, "Scan", scans=[broken])
    assert old.read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "report.html"]


@pytest.mark.whole
def test_the_caption_of_a_response_says_what_is_drawn(tmp_path: Path) -> None:
    fitted, levels = response()
    parts = {
        "measured": tuple(
            ResponseLevel(shown=x, seen=y, sigma=0.001, residual=0.0) for x, y in levels.tolist()
        ),
        "regions": tuple(Region(row=0, column=k, a=0.9, b=0.02, g=2.2, sigma_g=0.003) for k in range(3)),
    }
    for name, drawn in (("curve", fitted), ("regions", fitted.model_copy(update=parts))):
        path = tmp_path / f"{name}.html"
        write_report(path, "Response", response=(drawn, levels))
        page = path.read_text(encoding="utf-8")
        assert ("exponent of each region" in page) == (name == "regions")
        assert ("Right: measured minus fitted" in page) == (name == "curve")
