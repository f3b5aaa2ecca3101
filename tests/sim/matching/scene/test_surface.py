"""Surfaces of parts: told from a scan, and what is then predicted for them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from fpplab.core import config
from fpplab.core.conventions import Image, Lattice, PixelIndices
from fpplab.core.errors import DataError
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Predictable
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan
from fpplab.pipeline.taking import take_or_resume_session
from sim.matching.judging.measured import measured_figures
from sim.matching.parts import match_parts
from sim.matching.refusal import Refusals
from sim.matching.run import twin_of
from sim.matching.scene.artefacts import BenchScan
from sim.matching.scene.surface import match_surface, with_surfaces
from sim.part_surface import PartSurface
from sim.prediction import predict
from sim.prediction.discrepancy import Deviation, Discrepancy
from sim.twin import ExpectedLevels
from tests.support.plane_twin import PROJECTOR, SETTINGS, PlaneTwin, Remembered, nominal, tilted

PLAN = Plan(fringes=tuple(Sinusoid(axis="x", stripes=n, steps=4) for n in (1, 24)))
ITEM = "pyramid"
POSE = RigidTransform.from_vectors(np.radians([180.0, 0, 0]), np.array([0.0, 0, 455]))


class CoatedTwin(PlaneTwin):
    """Parts have a white matt body and a coat that shines about one place, the wider the rougher."""

    def expected_part(
        self,
        item: str,
        pose: RigidTransform,
        patterns: Sequence[Pattern],
        settings: CameraSettings,
        pixels: PixelIndices,
    ) -> ExpectedLevels:
        surface = self.parameters.surfaces.get(item, PartSurface(0.9))
        rows, columns = (one.astype(np.float64) for one in pixels)
        mirror = np.exp(
            -((rows - 150) ** 2 + (columns - 230) ** 2) / (2 * (200 * surface.gloss_roughness) ** 2)
        )
        part = (1 - surface.gloss) * surface.reflectance * (1 - 0.2 * columns / 456)
        part = part + surface.gloss * mirror / surface.gloss_roughness**2
        light = np.array([one.image.mean() / 255 + 0.2 * np.cos(n) for n, one in enumerate(patterns)])
        above = 240 * settings.exposure_s / SETTINGS.exposure_s * light[:, None] * part
        levels = 255 * self.parameters.black_level + above
        return np.asarray(levels.clip(0, 255), np.float32)

    def scan(
        self, item: str, pose: RigidTransform, patterns: Sequence[Pattern], settings: CameraSettings
    ) -> list[Image]:
        height, width = 304, 456
        every = np.indices((height, width)).reshape(2, -1)
        levels = self.expected_part(item, pose, patterns, settings, (every[0], every[1]))
        noisy = levels + np.random.default_rng(5).normal(0, 1, levels.shape)
        return list(np.rint(noisy).clip(0, 255).astype(np.uint8).reshape(-1, height, width))


def scanned(surface: PartSurface) -> BenchScan:
    """What a bench records of a part with this surface."""
    bench = CoatedTwin(nominal(tilted(1)))
    bench = bench.with_parameters(replace(bench.parameters, surfaces={ITEM: surface}))
    frames = bench.scan(ITEM, POSE, make_patterns(PLAN, PROJECTOR.size, Lattice.SQUARE), SETTINGS)
    session = Remembered(PLAN, frames, Path("scan"))
    return BenchScan(ITEM, cast(Any, session), cast(Any, None), POSE, cast(Any, None))


def off_in_sigmas(found: PartSurface, true: PartSurface) -> Mapping[str, float]:
    return {name: abs(getattr(found, name) - getattr(true, name)) / s for name, s in found.sigma.items()}


@pytest.mark.parametrize("reflectance", [0.25, 0.8])
def test_a_matt_surface_is_found(reflectance: float) -> None:
    twin = CoatedTwin(nominal(tilted(1)))
    before = twin.parameters
    found = match_surface(twin, scanned(PartSurface(reflectance)))
    assert twin.parameters is before
    assert found.surface.kind == "diffuse"
    assert found.surface.reflectance == pytest.approx(reflectance, rel=2e-3)
    assert off_in_sigmas(found.surface, PartSurface(reflectance))["reflectance"] < 3
    assert found.surface.sigma["reflectance"] < 0.01 * reflectance
    assert found.criterion["diffuse"] < found.criterion["glossy"]


def test_a_glossy_surface_is_found_although_its_highlight_is_saturated() -> None:
    true = PartSurface(0.45, 0.15, 0.3)
    found = match_surface(CoatedTwin(nominal(tilted(1))), scanned(true))
    assert found.surface.kind == "glossy"
    assert found.saturated > 0.05
    assert found.criterion["glossy"] < found.criterion["diffuse"] - 100
    assert found.explained > 0.95
    for name in ("reflectance", "gloss", "gloss_roughness"):
        assert getattr(found.surface, name) == pytest.approx(getattr(true, name), rel=0.03), name
    assert max(off_in_sigmas(found.surface, true).values()) < 4


def test_the_level_of_white_counts_in_the_uncertainty() -> None:
    twin, scan = CoatedTwin(nominal(tilted(1))), scanned(PartSurface(0.5))
    twin = twin.with_parameters(replace(twin.parameters, sigma={"white": 0.02}))
    assert match_surface(twin, scan).surface.sigma["reflectance"] == pytest.approx(0.01, rel=0.1)


def test_a_part_gets_its_surface_and_stands_where_its_scan_shows_it() -> None:
    twin, scan = CoatedTwin(nominal(tilted(1))), scanned(PartSurface(0.5))
    found = with_surfaces(twin.parameters, [match_surface(twin, scan)])
    assert found.surfaces[ITEM].reflectance == pytest.approx(0.5, rel=2e-3)
    assert found.placed[ITEM] is POSE


def test_a_saturated_scan_tells_no_surface() -> None:
    with pytest.raises(DataError, match="scan: is saturated; expose it shorter"):
        match_surface(CoatedTwin(nominal(tilted(1))), scanned(PartSurface(9.0)))


def data(name: str, kind: str) -> dict[str, Any]:
    found = config.find_config(name, kind)
    parsed: dict[str, Any] = config.parse_yaml(config.read_text(found), found)
    return parsed


DARK = {"reflectance": 0.25}
GLOSSY = {"kind": "glossy", "reflectance": 0.4, "gloss": 0.25, "gloss_roughness": 0.35}


@pytest.fixture(scope="module")
def twin_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A twin whose parts are white, as the twin's own file says; it was matched to its board."""
    folder = tmp_path_factory.mktemp("twin")
    written(folder, {})
    Discrepancy(noise=Deviation.of([0.01, -0.01], fitted=False)).save(folder)
    return folder / "rig.yaml"


def written(folder: Path, materials: Mapping[str, Any]) -> Path:
    world, rig = data("world_demo", "world"), data("rig_demo", "rig")
    world["items"] |= {name: world["items"]["steps"] | {"material": name} for name in materials}
    world["items"] |= dict.fromkeys({"dark", "glossy"} - materials.keys(), world["items"]["steps"])
    world |= {"materials": dict(materials), "render": {"cache": False}}
    rig["bench"] |= {"binning": 8, "subpixels": 2, "world": "world.yaml"}
    for name, one in (("world", world), ("rig", rig)):
        (folder / f"{name}.yaml").write_text(config.to_yaml(one))
    return folder / "rig.yaml"


def test_a_matched_rig_keeps_the_settings_of_its_camera(twin_rig: Path, tmp_path: Path) -> None:
    text = twin_rig.read_text()
    changed = config.parse_yaml(text, twin_rig)
    changed["camera"] |= {"gain_db": 15.0, "bits": 12}
    twin_rig.with_name("gain.yaml").write_text(config.to_yaml(changed))
    with Rig.load(twin_rig.with_name("gain.yaml")) as rig:
        match_parts(twin_of(rig, "board"), {}, tmp_path / "matched", rig, Refusals())
    saved = Rig.load(tmp_path / "matched" / "rig.yaml").camera_settings(0.02)
    assert (saved.gain_db, saved.bits) == (15.0, 12)


@pytest.mark.nightly
@pytest.mark.parametrize(("item", "material"), [("dark", DARK), ("glossy", GLOSSY)])
def test_dark_and_glossy_parts_are_predicted_as_a_bench_measures_them(
    item: str, material: Mapping[str, Any], twin_rig: Path, tmp_path: Path
) -> None:
    """The matching never reads the bench's world file. By the twin's own file noise is off by far."""
    plan = Plan.load("plan_nine_images")
    (tmp_path / "bench").mkdir()
    with Rig.load(written(tmp_path / "bench", {item: material})) as bench:
        session = take_or_resume_session(bench, plan, tmp_path / "scan", (item, 0), accept_complete=True)
        assert isinstance(bench.simulation, Predictable)
        sampler = bench.simulation.image_part_sampler()
        real = measured_figures(session, sampler.calibration, sampler.mesh(item))
    with Rig.load(twin_rig) as rig:
        white = predict(rig, plan, item)
        twin = twin_of(rig, "board")
        (found,) = match_parts(twin, {item: session}, tmp_path / "matched", rig, Refusals())
    assert white.surface is None
    assert abs(white.figures["noise_um"].value / real.noise_um - 1) > 0.15
    assert found.surface.kind == material.get("kind", "diffuse")
    for name in ("reflectance", "gloss", "gloss_roughness"):
        if name in material:
            assert getattr(found.surface, name) == pytest.approx(material[name], rel=0.05), name
    with Rig.load(tmp_path / "matched" / "rig.yaml") as rig:
        said = predict(rig, plan, item)
    assert said.surface == found.surface
    assert said.discrepancy is not None
    for name in ("distance_um", "noise_um"):
        assert said.figures[name].value == pytest.approx(getattr(real, name), rel=0.1), name
