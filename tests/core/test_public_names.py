"""The public names: documented, taken as text where paths are, short in print, and rich in a notebook."""

import base64
import inspect
import io
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image as Pixels

import fpplab
from fpplab import Calibration, Cloud, Comparison, Decoded, Plan, Recording, Rig, Session
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.extras import MissingExtraError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.core.notebook import axes_or_new, grey_picture, html_table, plot_map
from fpplab.devices import CameraSettings, Frame
from tests.support.commands import ROOT

POINTS = np.array([[0, 0, 400], [1, 0, 410], [0, 1, 420], [1, 1, 430]], np.float32)
PIXELS = np.array([[0, 0], [1, 0], [0, 1], [2, 1]], np.int32)
SIGMAS = np.array([0.001, 0.002, 0.003, 0.004], np.float32)
GREY = np.array([0, 51, 102, 255], np.uint8)
NORMALS = np.tile(np.array([0, 0, -1], np.float32), (4, 1))
BARE = Cloud(POINTS)
CLOUD = Cloud(POINTS, PIXELS, (3, 2), NORMALS, GREY, SIGMAS)
DEPTHS = np.array([[400, 410, np.nan], [420, np.nan, 430]], np.float32)


def calibration() -> Calibration:
    """A camera of 90° that looks along z, and the same as projector 100 mm to the right."""
    one = Pinhole.from_focal((100, 80), (50.0, 50.0), (49.5, 39.5))
    return Calibration(one, one, RigidTransform(np.eye(3), np.array([-100.0, 0.0, 0.0])), {"joint": 0.0712})


def comparison() -> Comparison:
    distances = np.array([0.01, -0.02, 0.03, 9.0], np.float32)
    counted = np.array([True, True, True, False])
    return Comparison(
        20.0, 5.0, 15.0, 21.6, 29.0, 0.95, 0, 0.5, 3, 1, 200.0, 1.0, 0.5, False, None, distances, counted
    )


def decoded() -> Decoded:
    u = np.array([[1.5, np.nan, 3.5]], np.float32)
    return Decoded(u, np.full_like(u, np.nan), 10 * u, u / 100)


@pytest.fixture
def session(tmp_path: Path) -> Session:
    plan = Plan.model_validate({"fringes": ({"axis": "x", "stripes": 1.0, "steps": 3},)})
    made = Session.create(str(tmp_path / "scan"), plan)
    for index, (_, _, name) in enumerate(plan.steps()):
        image = np.full((4, 6), 40 * index, np.uint8)
        made.write(Frame(image, index, CameraSettings(exposure_s=0.02), 0.0, 0.0, name))
    return Session.open(str(made.path))


def test_every_name_is_in_the_documentation() -> None:
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    told = re.findall(r"^\| `(\w+)`", page, re.MULTILINE)
    assert told == sorted(set(told), key=str.lower)
    assert {*told} == {*fpplab.__all__} - {"__version__"}


def path_parameters() -> list[tuple[str, str]]:
    found = []
    for name in fpplab.__all__:
        thing = getattr(fpplab, name)
        functions = {name: thing} if inspect.isfunction(thing) else {}
        if inspect.isclass(thing):
            own = {k: getattr(thing, k) for k in dir(thing) if not k.startswith("_")}
            functions = {f"{name}.{k}": f for k, f in own.items() if callable(f)}
        for place, function in functions.items():
            if not getattr(function, "__module__", "").startswith("fpplab"):
                continue
            for parameter in inspect.signature(function).parameters.values():
                if "Path" in str(parameter.annotation):
                    found.append((f"{place}({parameter.name})", str(parameter.annotation)))
    return found


def test_text_is_taken_where_paths_are() -> None:
    taken = path_parameters()
    assert len(taken) > 10
    assert [place for place, kind in taken if "str" not in kind] == []


def test_they_print_in_a_line(session: Session) -> None:
    plan = session.plan
    recording = Recording([np.zeros((4, 6), np.uint8)] * 3, plan, (6, 4), name="mine")
    rig = Rig.load("rig_demo")
    things = (calibration(), CLOUD, comparison(), decoded(), plan, recording, rig, session)
    shown = [repr(one) for one in things]
    assert [one for one in shown if len(one) > 240 or "\n" in one or not one.startswith("<")] == []
    assert repr(plan) == "<Plan: x 1 x 3; 3 images, hierarchical>"
    assert repr(recording) == f"<Recording mine: 3 frames of 6 x 4 px, 8 bits; {plan!r}>"
    assert repr(decoded()) == "<Decoded: 3 x 1 px, 2 measured (66.7 %)>"
    assert repr(comparison()) == (
        "<Comparison: 15.0 µm surface SMCD, 21.6 µm RMS, 3 points, 95.0 % complete, not aligned>"
    )
    assert repr(replace(comparison(), surface_smcd_um=None)).startswith("<Comparison: 20.0 µm SMCD, ")
    assert "camera virtual_camera, projector virtual_projector" in repr(rig)


def test_a_table_is_escaped_and_leaves_out_what_is_not_known() -> None:
    made = html_table("a<b", {"x": "1 & 2", "none": None})
    assert made == (
        "<div><table><caption><b>a&lt;b</b></caption><tr><th style='text-align:left'>x</th>"
        "<td style='text-align:left'>1 &amp; 2</td></tr></table></div>"
    )


def test_a_picture_is_stretched_small_and_transparent_where_nothing_is_known() -> None:
    values = np.tile(np.linspace(0.0, 100.0, 1001), (3, 1))
    values[0, 0] = np.nan
    with Pixels.open(io.BytesIO(grey_picture(values))) as picture:
        assert picture.size == (201, 1)
        grey, alpha = np.asarray(picture)[0].T.astype(int)
    assert (alpha[0], *set(alpha[1:])) == (0, 255)
    assert (grey[1], grey[-1]) == (0, 255)  # 0.5 and 100: beyond the percentiles
    assert grey[100] == pytest.approx(255 * (50.0 - 2.0) / 96.0, abs=1)
    assert grey_picture(np.full((2, 2), np.nan)).startswith(b"\x89PNG")


def test_rich_forms(session: Session) -> None:
    cloud = CLOUD._repr_html_()
    assert "<td style='text-align:left'>400.00 … 430.00 mm</td>" in cloud
    assert "median 2.5 µm" in cloud
    data = base64.b64decode(re.findall(r"base64,([^']+)", cloud)[0])
    with Pixels.open(io.BytesIO(data)) as picture:
        assert np.asarray(picture)[..., 1].tolist() == (255 * np.isfinite(DEPTHS)).tolist()
    assert "<img" not in BARE._repr_html_()
    assert "3 of 3" in session._repr_html_()
    assert "<img" in session._repr_html_()
    assert "100.00 mm" in calibration()._repr_html_()
    assert "15.0 µm" in comparison()._repr_html_()
    assert "2 pixels (66.7 %)" in decoded()._repr_html_()


def test_plots_are_of_the_values() -> None:
    axes = Figure().subplots()
    assert CLOUD.plot("z", axes) is axes
    np.testing.assert_array_equal(axes.images[0].get_array().filled(np.nan), DEPTHS)
    assert BARE.plot("x", Figure().subplots()).collections[0].get_offsets().tolist() == POINTS[:, :2].tolist()
    with pytest.raises(ConfigError, match="values: 'q' must be one of x, y, z, colour, sigma_mm"):
        CLOUD.plot("q", axes)
    with pytest.raises(DataError, match=r"sigma_mm is not known; known are x, y, z$"):
        BARE.plot("sigma_mm", axes)
    with pytest.raises(DataError, match=r"sigma_mm is not known; known are x, y, z, colour, sigma_noise_mm$"):
        CLOUD.plot("sigma_mm", axes)
    image = decoded().plot("modulation", Figure().subplots()).images[0].get_array()
    assert image.filled(np.nan).tolist()[0][::2] == [15.0, 35.0]
    with pytest.raises(ConfigError, match="'q' must be one of u, v, modulation, sigma"):
        decoded().plot("q")


def test_maps_are_of_values_and_of_names() -> None:
    np.testing.assert_array_equal(CLOUD.map_of("z"), DEPTHS)
    np.testing.assert_array_equal(CLOUD.map_of("sigma_noise_mm"), CLOUD.map_of(SIGMAS))
    with pytest.raises(ConfigError, match="values: 'q' must be one of x, y, z, colour, sigma_mm"):
        CLOUD.map_of("q")
    with pytest.raises(DataError, match="sigma_form_mm is not known; known are x, y, z, colour"):
        CLOUD.map_of("sigma_form_mm")


def test_a_histogram_is_of_counted_distances() -> None:
    axes = comparison().plot(Figure().subplots())
    assert sum(patch.get_height() for patch in axes.patches) == 3
    assert axes.get_xlabel() == "distance from the true surface, µm"


def test_fields_of_view_from_above() -> None:
    """The pinhole of 100 columns and f = 50 px sees 45° to either side."""
    camera, projector = calibration().plot(300.0, Figure().subplots()).lines
    np.testing.assert_allclose(camera.get_xydata(), [[-300, 300], [0, 0], [300, 300]], atol=1e-9)
    np.testing.assert_allclose(projector.get_xydata(), [[-200, 300], [100, 0], [400, 300]], atol=1e-9)


def test_a_frame_is_drawn_over_its_full_scale(session: Session) -> None:
    image = session.plot(2, Figure().subplots()).images[0]
    assert (image.get_clim(), image.get_array().max()) == ((0, 255), 80)
    assert session.plot(0, Figure().subplots()).images[0].get_array().max() == 0


def test_the_brightest_frame_is_drawn_unless_another_is_wanted(session: Session, tmp_path: Path) -> None:
    axes = session.plot(axes=Figure().subplots())
    assert (axes.get_title(), axes.images[0].get_array().max()) == ("frame 2", 80)
    empty = Session.create(tmp_path / "empty", session.plan)
    with pytest.raises(DataError, match="has no frames yet"):
        empty.plot(axes=Figure().subplots())


def test_new_axes_are_in_a_figure_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    mpl.use("agg")
    from matplotlib import pyplot as plt

    axes = plot_map(DEPTHS, "z, mm")
    assert axes is not axes_or_new(None)
    plt.close("all")


def test_a_cloud_for_xarray() -> None:
    made = CLOUD.to_xarray()
    assert dict(made.sizes) == {"v": 2, "u": 3}
    np.testing.assert_array_equal(made.z.values, DEPTHS)
    assert (made.z.units, made.sigma_noise_mm.units, made.colour.units) == ("mm", "mm", "grey level")
    assert made.nz.values[0, 0] == -1.0
    assert dict(BARE.to_xarray().sizes) == {"point": 4}
    maps = decoded().to_xarray()
    np.testing.assert_array_equal(maps.projector_u.values, decoded().u)
    assert {*maps.data_vars} == {"projector_u", "projector_v", "modulation", "sigma"}


def test_a_cloud_for_trimesh() -> None:
    points = np.array([[0, 0, 400], [1, 0, 400], [0, 1, 400], [1, 1, 400]], np.float32)
    pixels = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.int32)
    mesh = Cloud(points, pixels, (2, 2)).to_trimesh()
    assert mesh.vertices.tolist() == points.tolist()
    assert mesh.area == pytest.approx(1.0)
    assert (mesh.face_normals[:, 2] < 0).all()  # towards the camera
    with pytest.raises(DataError, match="not known by camera pixel"):
        BARE.to_trimesh()


def test_a_cloud_for_open3d(monkeypatch: pytest.MonkeyPatch) -> None:
    geometry, utility = ModuleType("open3d.geometry"), ModuleType("open3d.utility")
    geometry.PointCloud = lambda points: SimpleNamespace(points=points)  # type: ignore[attr-defined]
    utility.Vector3dVector = np.asarray  # type: ignore[attr-defined]
    package = ModuleType("open3d")
    package.__spec__ = SimpleNamespace()  # type: ignore[assignment]
    modules: dict[str, Any] = {"open3d": package, "open3d.geometry": geometry, "open3d.utility": utility}
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    made = CLOUD.to_open3d()
    assert made.points.dtype == np.float64
    assert made.points.tolist() == POINTS.tolist()
    assert made.normals.tolist() == NORMALS.tolist()
    np.testing.assert_allclose(made.colors, np.repeat([[0.0], [0.2], [0.4], [1.0]], 3, axis=1))
    assert not hasattr(BARE.to_open3d(), "colors")


@pytest.mark.parametrize("name", ["open3d", "xarray"])
def test_a_missing_library_is_named(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fpplab.core.extras.find_spec", lambda module: None)
    with pytest.raises(MissingExtraError, match=f"{name} is not installed; .* pip install {name}$"):
        getattr(CLOUD, f"to_{name}")()
