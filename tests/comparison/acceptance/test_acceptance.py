"""The acceptance test gives what theory says of shapes, noise and form errors that are known."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import norm
from typer.testing import CliRunner

from fpplab import artefacts
from fpplab.artefacts.shapes.ball_bar import BallBar
from fpplab.cli.every import app
from fpplab.cli.lists import repeat_option_per_path
from fpplab.clouds import Cloud, save_cloud
from fpplab.comparison.acceptance import Standard, verify, verify_ball_bar, verify_plane
from fpplab.comparison.acceptance.fitting import DISCARDED_SHARE
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.geometry import RigidTransform

PITCH = 0.25 / 450
"""Slope from one camera ray to the next: 0.25 mm at a distance of 450 mm."""
SIGMA = 0.010
KEPT_SPAN = 2 * norm.ppf(1 - DISCARDED_SHARE / 2)
"""Span in standard deviations of normal noise without its worst 3 per mille: 5.94."""

BAR = (np.array([-35.0, 3.0, 450.0]), np.array([35.0, -2.0, 455.0]))
SPACING = float(np.linalg.norm(BAR[1] - BAR[0]))


def standard(**changes: Any) -> Standard:
    plain: dict[str, Any] = {
        "name": "test",
        "ball_bar": {"diameters_mm": [20.0, 20.0], "spacing_mm": SPACING},
        "plane": {"size_mm": [100.0, 80.0]},
        "mpe_um": {"PF": 100.0, "PS": 20.0, "SD": 20.0, "F": 100.0},
    }
    return config.validate(plain | changes, Standard, "standard.yaml")


def rays() -> Floats:
    """Directions (N, 3) with z = 1 of a camera's pixels."""
    a, b = np.meshgrid(np.arange(-300, 301) * PITCH, np.arange(-200, 201) * PITCH)
    return np.asarray(np.stack([a, b, np.ones_like(a)], axis=-1).reshape(-1, 3))


def spheres_over_a_wall(centres: tuple[Floats, ...] = BAR, radius: float = 10.0, sigma: float = 0.0) -> Cloud:
    """What a camera measures of spheres before a wall at 480 mm, with noise along the surface's normal."""
    directions = rays()
    points = directions * 480.0
    normals = np.tile([0.0, 0.0, -1.0], (len(points), 1))
    for centre in centres:
        square = (directions**2).sum(axis=1)
        along = directions @ centre
        root = along**2 - square * (centre @ centre - radius**2)
        hit = root > 0
        depth = (along[hit] - np.sqrt(root[hit])) / square[hit]
        points[hit] = directions[hit] * depth[:, None]
        normals[hit] = (points[hit] - centre) / radius
    random = np.random.default_rng(1)
    points = points + sigma * random.standard_normal(len(points))[:, None] * normals
    return Cloud(points.astype(np.float32), normals=normals.astype(np.float32))


def tilted_plane(sigma: float = 0.0, wave: float = 0.0, size: tuple[float, float] = (100.0, 80.0)) -> Cloud:
    """What a camera measures of a plane standard, tilted by 20°, of which a whole wave stands out."""
    pose = RigidTransform.from_vectors(np.radians([20.0, 0.0, 0.0]), np.array([5.0, -3.0, 450.0]))
    directions, normal = rays(), pose.rotation[:, 2]
    points = directions * (normal @ pose.translation / (directions @ normal))[:, None]
    x, y, _ = ((points - pose.translation) @ pose.rotation).T
    inside = (np.abs(x) < size[0] / 2) & (np.abs(y) < size[1] / 2)
    noise = sigma * np.random.default_rng(2).standard_normal(len(points))
    noise += wave * np.cos(2 * np.pi * x / 7.0)
    return Cloud((points + noise[:, None] * normal)[inside].astype(np.float32))


# The quantities


def test_a_perfect_ball_bar_has_no_errors() -> None:
    found = verify_ball_bar(spheres_over_a_wall(), standard(), "bar")
    assert found.spacing_error_um == pytest.approx(0.0, abs=0.05)  # points are 32 bit floats
    for test in found.spheres:
        assert test.form_um < 0.2
        assert test.size_um == pytest.approx(0.0, abs=0.05)
        assert test.measured.pixels is None


def test_noise_gives_the_span_of_its_quantiles() -> None:
    found = verify_ball_bar(spheres_over_a_wall(sigma=SIGMA), standard(), "bar")
    for test in found.spheres:
        count = len(test.measured.points)
        quantile = KEPT_SPAN / 2
        one_end = np.sqrt(DISCARDED_SHARE / 2 / count) / norm.pdf(quantile)  # of an empirical quantile
        assert test.form_um == pytest.approx(1e3 * SIGMA * KEPT_SPAN, abs=4e3 * SIGMA * np.sqrt(2) * one_end)
        assert test.measured.rms_um == pytest.approx(1e3 * SIGMA, rel=0.06)
        assert abs(test.size_um) < 4e3 * 2 * SIGMA * 5.0 / np.sqrt(count)
    assert abs(found.spacing_error_um) < 4e3 * SIGMA * 2.0 / np.sqrt(count)


@pytest.mark.parametrize("scale", [0.999, 1.001])
def test_an_error_of_scale_is_found_in_size_and_spacing(scale: float) -> None:
    whole = spheres_over_a_wall()
    cloud = Cloud((scale * whole.points).astype(np.float32), normals=whole.normals)
    found = verify_ball_bar(cloud, standard(), "bar")
    assert found.spacing_error_um == pytest.approx(1e3 * SPACING * (scale - 1), abs=0.1)
    for test in found.spheres:
        assert test.size_um == pytest.approx(1e3 * 20.0 * (scale - 1), abs=0.1)


def test_gross_errors_beyond_three_per_mille_count() -> None:
    """Points that came to lie off the sphere are not taken for something else."""
    cloud = spheres_over_a_wall()
    stray = np.linalg.norm(cloud.points - BAR[0].astype(np.float32), axis=1) < 10.5
    chosen = np.flatnonzero(stray)[::100]
    points = cloud.points.copy()
    points[chosen] *= np.float32(1.002)
    found = verify_ball_bar(Cloud(points, normals=cloud.normals), standard(), "bar")
    left = min(found.spheres, key=lambda test: float(test.sphere.centre[0]))
    right = max(found.spheres, key=lambda test: float(test.sphere.centre[0]))
    assert left.form_um > 500
    assert right.form_um < 1


def test_both_conventions_of_form_error_are_given() -> None:
    """One point in a thousand, 4.5 mm off: the range of all points shows it, that without 3 ‰ does not."""
    cloud = spheres_over_a_wall()
    points = cloud.points.copy()
    points[np.flatnonzero(np.linalg.norm(points - BAR[0].astype(np.float32), axis=1) < 10.5)[::1000]] *= 1.01
    found = verify(standard(), [("bar", Cloud(points, normals=cloud.normals))], [("plane", tilted_plane())])
    judged = found.judgements()
    assert judged["PF"].worst_um < 1
    assert judged["PF"].worst_all_um == pytest.approx(4400, rel=0.05)
    assert judged["SD"].worst_all_um is None
    plain = found.summary()
    assert {sphere["PF_all_um"] > 4000 for sphere in plain["spheres"]} == {True, False}
    assert plain["planes"][0]["F_all_um"] == pytest.approx(plain["planes"][0]["F_um"], abs=0.05)
    assert plain["cap_deg"] == 60.0
    assert plain["conventions"]["PF_all"] == "range of all points"


def test_a_few_stray_points_are_discarded_and_nothing_moves() -> None:
    cloud = spheres_over_a_wall()
    chosen = np.flatnonzero(np.linalg.norm(cloud.points - BAR[0].astype(np.float32), axis=1) < 10.5)[::1000]
    points = cloud.points.copy()
    points[chosen] *= np.float32(1.01)
    found = verify_ball_bar(Cloud(points, normals=cloud.normals), standard(), "bar")
    assert max(test.form_um for test in found.spheres) < 1
    assert found.spacing_error_um == pytest.approx(0.0, abs=0.1)


def test_the_greater_sphere_is_the_one_of_greater_diameter() -> None:
    bar = {"diameters_mm": [20.5, 20.0], "spacing_mm": SPACING}
    one, other = (
        spheres_over_a_wall((BAR[0],), 10.0),
        spheres_over_a_wall((BAR[1],), 10.25),
    )
    swap = one.points[:, 0] > 0
    points = np.where(swap[:, None], other.points, one.points)
    assert one.normals is not None
    assert other.normals is not None
    normals = np.where(swap[:, None], other.normals, one.normals)
    found = verify_ball_bar(Cloud(points, normals=normals), standard(ball_bar=bar), "bar")
    assert [test.number for test in found.spheres] == [1, 2]
    assert found.spheres[0].sphere.centre[0] > 0
    assert [test.size_um for test in found.spheres] == pytest.approx([0.0, 0.0], abs=0.1)


def test_the_solid_angle_of_a_whole_cap() -> None:
    found = verify_ball_bar(spheres_over_a_wall(), standard(), "bar")
    for test in found.spheres:
        # Rays that come at 60° meet the sphere a little less than 60° from its middle.
        distance = float(np.linalg.norm(test.sphere.centre))
        edge = np.radians(60) - np.arcsin(10 * np.sin(np.radians(60)) / distance)
        assert test.solid_angle_sr == pytest.approx(2 * np.pi * (1 - np.cos(edge)), rel=0.01)


def test_a_flat_plane_has_no_error() -> None:
    found = verify_plane(tilted_plane(), standard(), "plane")
    assert found.flatness_um < 0.2
    assert found.area_mm2 == pytest.approx(98 * 78, rel=0.04)
    assert found.plane.normal @ found.plane.point < 0  # towards the camera


def test_noise_on_a_plane_gives_the_span_of_its_quantiles() -> None:
    found = verify_plane(tilted_plane(SIGMA), standard(), "plane")
    one_end = np.sqrt(DISCARDED_SHARE / 2 / len(found.measured.points)) / norm.pdf(KEPT_SPAN / 2)
    expected = 1e3 * SIGMA * KEPT_SPAN
    assert found.flatness_um == pytest.approx(expected, abs=4e3 * SIGMA * np.sqrt(2) * one_end)
    assert found.measured.rms_um == pytest.approx(1e3 * SIGMA, rel=0.03)


def test_a_wave_on_a_plane_is_its_flatness() -> None:
    found = verify_plane(tilted_plane(wave=0.05), standard(), "plane")
    assert found.flatness_um == pytest.approx(100.0, rel=0.02)


def test_mixed_pixels_at_the_edge_do_not_count() -> None:
    cloud = tilted_plane()
    y = cloud.points[:, 1]
    edge = y > y.max() - 0.6
    points = cloud.points.copy()
    points[edge] *= np.float32(1.004)
    assert verify_plane(Cloud(points), standard(), "plane").flatness_um < 0.2
    middle = np.hypot(cloud.points[:, 0], y) < 4.0
    points[middle] *= np.float32(1.004)
    assert verify_plane(Cloud(points), standard(), "plane").flatness_um > 1000


def test_a_plane_keeps_its_figures_before_another_wall() -> None:
    plane, directions = tilted_plane(), rays()
    wall = (directions * 520.0)[np.abs(directions[:, 0]) > 60 / 450]
    both = Cloud(np.concatenate([plane.points, wall.astype(np.float32)]))
    assert verify_plane(both, standard(), "plane").flatness_um < 0.2


# Judgement


def test_judgement_keeps_what_the_standard_is_uncertain_by() -> None:
    bar = {"diameters_mm": [20.0, 20.0], "spacing_mm": SPACING - 0.015}  # so SD is 15 µm
    cloud = spheres_over_a_wall()
    sure = verify(standard(ball_bar=bar), [("bar", cloud)])
    assert sure.judgements()["SD"].passed is True
    assert sure.passed is True
    unsure = verify(standard(ball_bar=bar | {"spacing_known_to_um": 6.0}), [("bar", cloud)])
    assert unsure.judgements()["SD"].passed is False
    assert unsure.judgements()["PS"].passed is True
    assert unsure.passed is False


def test_a_quantity_without_a_limit_is_not_judged() -> None:
    found = verify(standard(mpe_um={"PF": 100.0}), planes=[("plane", tilted_plane())])
    assert found.passed is None
    assert found.judgements().keys() == {"F"}
    assert found.judgements()["F"].passed is None
    assert any("not judged" in notice for notice in found.notices())


def test_the_worst_value_keeps_its_sign_and_few_positions_are_told() -> None:
    bar = {"diameters_mm": [20.03, 20.03], "spacing_mm": SPACING}
    found = verify(standard(ball_bar=bar), [(name, spheres_over_a_wall()) for name in ("one", "two")])
    judged = found.judgements()
    assert judged["PS"].worst_um == pytest.approx(-30.0, abs=0.1)
    assert (judged["PS"].positions, judged["SD"].positions) == (4, 2)
    assert found.passed is False
    assert {name: j.min_positions for name, j in judged.items()} == {"PF": 10, "PS": 10, "SD": 7}
    assert any("SD: measured in 2 of at least 7" in notice for notice in found.notices())
    fewer = standard(ball_bar=bar).with_positions(["PF=4", "PS=4", " SD = 2"])
    again = verify(fewer, [(name, spheres_over_a_wall()) for name in ("one", "two")])
    assert not any("at least" in notice for notice in again.notices())
    json.dumps(found.summary(), allow_nan=False)


# Refusals


def half_lit(cloud: Cloud) -> Cloud:
    """Without the left three quarters of the left sphere."""
    assert cloud.normals is not None
    lit = (cloud.points[:, 0] > BAR[0][0] + 4.5) | (cloud.points[:, 2] > 470)
    return Cloud(cloud.points[lit], normals=cloud.normals[lit])


@pytest.mark.parametrize(
    ("cloud", "words"),
    [
        (lambda: spheres_over_a_wall((BAR[0],)), "1 of 2 spheres of 20 mm"),
        (lambda: spheres_over_a_wall(()), "0 of 2 spheres of 20 mm"),
        (lambda: spheres_over_a_wall((BAR[0], BAR[0] + [30.0, 0, 0])), "spacing measures 30 mm"),
        (lambda: spheres_over_a_wall(radius=7.0), "of 20 mm were found|diameter measures"),
        (lambda: half_lit(spheres_over_a_wall()), "sr, less than 1.5 sr"),
        (tilted_plane, "its points are not known by camera pixel"),
    ],
)
def test_a_ball_bar_that_is_not_there_is_refused(cloud: Any, words: str) -> None:
    with pytest.raises(DataError, match=words):
        verify_ball_bar(cloud(), standard(), "bar.ply")


def test_too_few_points_and_too_wide_an_edge_are_refused() -> None:
    cloud = spheres_over_a_wall()
    with pytest.raises(DataError, match="fewer than 5000"):
        verify_ball_bar(cloud, standard(evaluation={"least_points": 5000}), "bar.ply")
    with pytest.raises(DataError, match="an edge of 10 mm"):
        verify_ball_bar(cloud, standard(evaluation={"edge_mm": 10.0}), "bar.ply")
    with pytest.raises(DataError, match="fewer than 500000"):
        verify_plane(tilted_plane(), standard(evaluation={"least_points": 500_000}), "plane.ply")


@pytest.mark.parametrize(
    ("cloud", "words"),
    [
        (lambda: tilted_plane(size=(50.0, 40.0)), "mm² of the plane count, less than 0.5"),
        (lambda: tilted_plane(size=(130.0, 80.0)), "the plane found measures 130 x 80 mm"),
        (
            lambda: Cloud(np.random.default_rng(0).uniform(-40, 40, (3000, 3)).astype(np.float32) + 400),
            "plane",
        ),
        (lambda: Cloud(np.ones((2, 3), np.float32)), "no plane was found"),
    ],
)
def test_a_plane_that_is_not_there_is_refused(cloud: Any, words: str) -> None:
    with pytest.raises(DataError, match=words):
        verify_plane(cloud(), standard(), "plane.ply")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"ball_bar": None, "plane": None}, "neither 'ball_bar' nor 'plane'"),
        ({"ball_bar": {"diameters_mm": [20.0, 20.0], "spacing_mm": 15.0}}, "'spacing_mm' is 15"),
        ({"ball_bar": {"diameters_mm": [20.0, 30.0], "spacing_mm": 70.0}}, "'diameters_mm' are"),
        ({"ball_bar": {"diameters_mm": [20.0], "spacing_mm": 70.0}}, "ball_bar.diameters_mm"),
        ({"plane": {"size_mm": [-1.0, 5.0]}}, r"'plane.size_mm\[0\]' is -1"),
        ({"plane": {"size_mm": [50.0, 50.0], "flatness_um": 200.0}}, "'mpe_um.F' is 100: must exceed 200"),
        ({"evaluation": {"cap_deg": 95.0}}, "'evaluation.cap_deg' is 95"),
        ({"mpe_um": {"PX": 5.0}}, "unknown key 'mpe_um.PX'"),
        ({"mpe_um": {"PF": 0.0}}, "'mpe_um.PF' is 0"),
        ({"plane": None, "items": {"plane": ["a"]}}, "'items.plane' is given"),
        ({"items": {"plane": ["../a"]}}, r"'items.plane\[0\]' is '../a'"),
        ({"items": {"plane": ["a"], "ball_bar": ["a"]}}, "'a' is named twice"),
    ],
)
def test_a_bad_standard_is_refused_by_field(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        standard(**changes)


@pytest.mark.parametrize("words", ["PX=3", "PF", "PF=wide", "PF=-1", "PF=nan"])
def test_bad_limits_are_refused(words: str) -> None:
    with pytest.raises(ConfigError, match="--mpe"):
        standard().with_mpe([words])


@pytest.mark.parametrize("words", ["PX=3", "PF", "PF=2.5", "PF=0", "SD=1001"])
def test_bad_numbers_of_positions_are_refused(words: str) -> None:
    with pytest.raises(ConfigError, match="--positions"):
        standard().with_positions([words])


def test_limits_of_the_command_line_go_before_the_file_s() -> None:
    changed = standard().with_mpe(["PF=7", " SD = 8 "])
    assert [changed.permitted_um(name) for name in ("PF", "PS", "SD", "F")] == [7.0, 20.0, 8.0, 100.0]


def test_nothing_to_verify_and_undescribed_standards_are_refused() -> None:
    with pytest.raises(ConfigError, match="nothing to verify"):
        verify(standard())
    with pytest.raises(ConfigError, match="'plane' is missing"):
        verify(standard(plane=None), planes=[("plane", tilted_plane())])


# The ball bar, and the command


def test_the_ball_bar_is_one_closed_body_as_true_as_its_facets() -> None:
    bar = BallBar()
    mesh = artefacts.make("ball_bar")
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert mesh.bounds.ravel() == pytest.approx([-50, -12, 0, 50, 12, 29])
    assert np.linalg.norm(bar.centres[1] - bar.centres[0]) == bar.spacing
    upper = mesh.triangles_center[mesh.triangles_center[:, 2] > bar.centres[0, 2]]
    nearest = np.min([np.linalg.norm(upper - c, axis=1) for c in bar.centres], axis=0)
    assert np.abs(nearest - bar.diameter / 2).max() < 1e-3


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("diameter", 70.0),
        ("post", 21.0),
        ("spacing", 95.0),
        ("clearance", 0.0),
        ("bar", (1.0, float("nan"), 5.0)),
        ("bar", (100.0, 24.0)),
    ],
)
def test_an_impossible_ball_bar_is_refused(field: str, value: Any) -> None:
    with pytest.raises(ConfigError, match=field):
        BallBar(**{field: value})


def test_lists_of_paths_are_spread() -> None:
    words = ["--spheres", "a", "b", "--json", "--planes", "c", "--out", "x"]
    plain = ["--spheres", "a", "--spheres", "b", "--json", "--planes", "c", "--out", "x"]
    assert repeat_option_per_path(words) == plain
    assert repeat_option_per_path(plain) == plain
    assert repeat_option_per_path(["--spheres=a", "--planes", "c"]) == ["--spheres=a", "--planes", "c"]


def run(*words: object) -> Any:
    return CliRunner().invoke(app, ["verify", *map(str, words)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two clouds of a ball bar, one of a plane, and their standard."""
    place = tmp_path_factory.mktemp("acceptance")
    (place / "standard.yaml").write_text(config.dump(standard()))
    for k in range(2):
        save_cloud(spheres_over_a_wall(sigma=SIGMA), place / f"bar{k}.ply")
    save_cloud(tilted_plane(SIGMA), place / "plane.npz")
    return place


@pytest.mark.whole
def test_the_command_judges_and_reports(folder: Path) -> None:
    bars, page = [folder / f"bar{k}.ply" for k in range(2)], folder / "verify.html"
    words = ["--standard", folder / "standard.yaml", "--spheres", *bars, "--planes", folder / "plane.npz"]
    done = run(*words, "--out", page, "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    keys = {"standard", "passed", "quantities", "spheres", "spacings", "planes", "notices", "report"}
    assert keys <= found.keys()
    assert found["passed"] is True
    assert [s["source"] for s in found["spacings"]] == [str(bar) for bar in bars]
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 3
    assert "Flatness measurement error F" in text
    assert "angle of incidence up to 60°" in text
    assert "PF_all 1 / 2 in µm" in text
    failing = run(*words, "--out", page, "--json", "--force", "--mpe", "PF=50,F=30")
    assert failing.exit_code == 0
    judged = json.loads(failing.stdout)["quantities"]
    assert {name: q["passed"] for name, q in judged.items()} == {
        "PF": False,
        "PS": True,
        "SD": True,
        "F": False,
    }


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "v.html"], "give either --spheres and --planes, or --rig"),
        (["--spheres", "a.ply", "a.ply", "--out", "v.html"], "a.ply: is given twice"),
        (["--spheres", "a.ply", "--rig", "rig_demo", "--out", "v.html"], "give either"),
        (["--rig", "rig_demo", "--out", "v.html"], "--rig needs --calibration"),
        (["--spheres", "none.ply", "--out", "v.html"], "none.ply: there is no such cloud or session"),
        (["--spheres", "none.ply", "--out", "v.pdf"], "must end in .html"),
        (["--spheres", "--out", "v.html"], "--spheres is followed by no path"),
    ],
)
def test_the_command_refuses_wrong_input(folder: Path, words: list[str], said: str) -> None:
    done = run("--standard", folder / "standard.yaml", *words)
    assert isinstance(done.exception, ConfigError | DataError)
    assert said in str(done.exception)


def test_rotated_spheres_keep_their_figures() -> None:
    """The same ball bar seen in another place has the same errors, to what the rays' raster changes."""
    turn = Rotation.from_euler("z", 40, degrees=True).as_matrix()
    middle = (BAR[0] + BAR[1]) / 2
    moved = tuple(turn @ (centre - middle) + middle for centre in BAR)
    found = verify_ball_bar(spheres_over_a_wall((moved[0], moved[1])), standard(), "bar")
    assert found.spacing_error_um == pytest.approx(0.0, abs=0.05)
