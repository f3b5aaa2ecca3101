"""`fpplab predict` and `fpplab compare-rigs` as a user runs them, on the virtual bench of `fpplab demo`."""

from dataclasses import replace
from pathlib import Path

import pytest

from fpplab.core import config
from fpplab.core.geometry import RigidTransform
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Predictable
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.pipeline.taking import take_or_resume_session
from sim.prediction.discrepancy import ContrastDeviation, Deviation, Discrepancy
from tests.support.commands import Command

PLAN = Plan(fringes=tuple(Sinusoid(axis="x", stripes=n, steps=4) for n in (1, 8, 48)), exposure_s=0.02)
ITEM = "steps"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig at an eighth of the sensor's pixels along each side, its scan, its calibration and a plan."""
    path = tmp_path_factory.mktemp("predict")
    found = config.find_config("rig_demo", "rig")
    data = config.parse_yaml(config.read_text(found), found)
    data["bench"] |= {"binning": 8, "subpixels": 2}
    (path / "rig.yaml").write_text(config.to_yaml(data))
    (path / "plan.yaml").write_text(config.dump(PLAN))
    with Rig.load(path / "rig.yaml") as rig:
        take_or_resume_session(rig, PLAN, path / "scan", (ITEM, 0))
        assert isinstance(rig.simulation, Predictable)
        true = rig.simulation.image_part_sampler().calibration
    true.save(path / "true.yaml")
    wide = RigidTransform(
        true.T_projector_camera.rotation, 1.01 * true.T_projector_camera.translation + [0.0, 0.0, 4.0]
    )
    replace(true, T_projector_camera=wide).save(path / "wrong.yaml")
    return path


@pytest.mark.whole
def test_a_measurement_is_predicted(fpplab: Command, folder: Path) -> None:
    call = ("predict", "--rig", folder / "rig.yaml", "--plan", folder / "plan.yaml", "--item", ITEM)
    done = fpplab(*call, "--json")
    assert done.code == 0, done.err
    answer = done.json
    for name in ("distance_um", "place_um", "noise_um", "completeness", "wrong_order", "seconds"):
        one = answer[name]
        assert one["low"] <= one["value"] <= one["high"], name
    assert (answer["item"], answer["images"], answer["matched"]) == (ITEM, 12, False)
    assert answer["predicted_in_s"] > 0
    shown = fpplab(*call)
    assert shown.code == 0, shown.err
    assert "noise" in shown.out
    assert "no discrepancy.yaml next to the rig file" in shown.err
    noisy = Deviation.of([0.5], fitted=False)
    Discrepancy(noise=noisy, parts=(ITEM,), looks_like="wax", not_for="wax").save(folder)
    try:
        told = fpplab(*call, "--json")
        assert told.json["noise_um"]["high"] > 1.5 * answer["noise_um"]["high"]
        assert told.json["not_for"] == "wax"
        assert told.json["compared_stripes"] is None
        coarse = ContrastDeviation(stripes=12, relative=0.01)
        apart = Deviation.of([3.0], fitted=False)
        Discrepancy(distance=apart, parts=(ITEM,), contrast=coarse).save(folder)
        wide = fpplab(*call, "--json")
        assert wide.json["compared_stripes"] == 12
        # Four times as many stripes: 16 times the logarithm.
        assert wide.json["noise_um"]["high"] > 1.2 * answer["noise_um"]["high"]
        shown = fpplab(*call)
        assert "fringes are finer than those of 12 stripes" in shown.err
        assert next(line for line in shown.out.splitlines() if "distance" in line).count("unknown") == 2
    finally:
        (folder / "discrepancy.yaml").unlink()


@pytest.mark.whole
def test_a_bench_is_compared_with_its_twin(fpplab: Command, folder: Path) -> None:
    """The bench is the twin: it measures what it predicts, and a wrong calibration is wrong for both."""
    call = ("compare-rigs", folder / "scan", "--rig", folder / "rig.yaml", "--item", ITEM)
    done = fpplab(*call, "--calibration", folder / "true.yaml", "--json")
    assert done.code == 0, done.err
    answer = done.json
    for one in answer["figures"].values():
        assert one["measured"] == pytest.approx(one["predicted"], rel=0.05, abs=1e-6)
    crossed = {name: one["distance_um"] for name, one in answer["crossed"].items()}
    assert set(crossed) == {"bench_by_bench", "bench_by_twin", "twin_by_bench", "twin_by_twin"}
    assert max(crossed.values()) < 1.05 * min(crossed.values())
    wrong = fpplab(*call, "--calibration", folder / "wrong.yaml", "--json").json
    assert wrong["crossed"]["bench_by_bench"]["distance_um"] > 1.2 * crossed["bench_by_bench"]
    assert wrong["crossed"]["twin_by_bench"]["distance_um"] > 1.2 * crossed["twin_by_twin"]
    assert wrong["crossed"]["bench_by_twin"]["distance_um"] == pytest.approx(crossed["bench_by_twin"])
    assert "distance_um" in wrong["outside"]
    shown = fpplab(*call, "--calibration", folder / "wrong.yaml")
    assert "bench by twin" in shown.out
    assert "outside of the predicted interval: distance_um" in shown.err


@pytest.mark.nightly
def test_the_surface_of_a_part_is_matched_and_told(fpplab: Command, folder: Path, tmp_path: Path) -> None:
    call = ("match", "--twin", folder / "rig.yaml", "--out", tmp_path / "twin")
    done = fpplab(*call, "--surface", f"{ITEM}={folder / 'scan'}", "--json")
    assert done.code == 0, done.err
    (found,) = done.json["surfaces"]
    assert (found["item"], found["kind"]) == (ITEM, "diffuse")
    found_world = config.find_config("world_demo", "world")
    true = config.parse_yaml(config.read_text(found_world), found_world)["material"]["reflectance"]
    assert found["reflectance"] == pytest.approx(true, abs=0.01)
    assert 0 < found["sigma"]["reflectance"] < 0.02
    predicted = fpplab(
        "predict", "--rig", tmp_path / "twin" / "rig.yaml", "--plan", folder / "plan.yaml",
        "--item", ITEM, "--json",
    )  # fmt: skip
    assert predicted.code == 0, predicted.err
    surface = predicted.json["surface"]
    assert surface == {name: found[name] for name in surface}
    again = fpplab(*call, "--surface", f"{ITEM}={folder / 'scan'}", "--json")
    assert again.code == 2
    assert "exists already" in again.json["error"]


@pytest.mark.whole
def test_a_surface_that_cannot_be_matched_is_told_before_the_work(
    fpplab: Command, folder: Path, tmp_path: Path
) -> None:
    call = ("match", "--twin", folder / "rig.yaml", "--out", tmp_path / "twin", "--json")
    for item, words in {"cup": "no item 'cup'", "board": "only artefacts and parts"}.items():
        done = fpplab(*call, "--surface", f"{item}={folder / 'scan'}")
        assert (done.code, words in done.json["error"]) == (2, True), done.err
    neither = fpplab(*call)
    assert neither.code == 2
    assert "name the bench's sessions of a board, or a --surface" in neither.json["error"]
    assert not (tmp_path / "twin").exists()


@pytest.mark.whole
def test_what_cannot_be_predicted_is_told(fpplab: Command, folder: Path) -> None:
    call = ("predict", "--rig", folder / "rig.yaml", "--plan", folder / "plan.yaml", "--json")
    missing = fpplab(*call, "--item", "cup")
    assert missing.code == 2
    assert "no item 'cup'" in missing.json["error"]
    real = fpplab("predict", "--rig", "rig_emulated", "--plan", "plan_paper", "--item", ITEM, "--json")
    assert real.code == 2
    assert "is no simulation that can predict" in real.json["error"]
    other = fpplab(
        "compare-rigs", folder / "scan", "--rig", "rig_demo", "--item", ITEM,
        "--calibration", folder / "true.yaml", "--json",
    )  # fmt: skip
    assert other.code == 2
    assert "684 x 456 pixels, the twin's" in other.json["error"]
