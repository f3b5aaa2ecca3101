"""Matching of a twin to a reference, both simulated by the plane twin, so that the truth is known."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import pytest
from skimage.metrics import structural_similarity

from fpplab.calibration.model import Calibration
from fpplab.characterisation import DistortionModel
from fpplab.core import config
from fpplab.core.errors import CalibrationError, ConfigError, DataError
from fpplab.core.geometry import RigidTransform
from fpplab.diagnosis.causes.of_characterisation import LENS_NOT_LOCKED
from fpplab.diagnosis.causes.of_matching_and_search import UNLIKE_IMAGES
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response, fit_response
from sim.effects.vibration import with_vibration_of
from sim.matching import match
from sim.matching.evaluation import evaluate
from sim.matching.fluctuation import noise
from sim.matching.fluctuation.frame_series import fit_fluctuation
from sim.matching.fluctuation.frame_terms import MOVES, terms_of_pose
from sim.matching.geometry import geometry_fit
from sim.matching.geometry.card import fitted_plane, moved_into_plane
from sim.matching.judging import plausibility
from sim.matching.light import light_fit
from sim.matching.light.gamma import match_gamma, with_level_of_card
from sim.matching.loss import Loss, Similarity, Weights, board_mask, ssim
from sim.matching.match import MatchingLimits, explained_shares, is_worse
from sim.matching.record import EPOCHS, MatchingEpoch, MatchingRecord, ParametersFile
from sim.matching.reference import Reference
from sim.matching.refusal import Refusals, acceptable_causes
from sim.matching.samples import sample_pixels
from sim.parameters import ADJUSTABLE, TwinParameters
from tests.support.plane_twin import (
    CAMERA,
    PAIR,
    PROJECTOR,
    SETTINGS,
    TARGET,
    PlaneTwin,
    Remembered,
    moved,
    nominal,
    tilted,
)

PLAN = Plan(fringes=(Sinusoid(axis="x", stripes=12, steps=4), Sinusoid(axis="y", stripes=8, steps=4)))
FACING = RigidTransform(np.eye(3), np.array([0.0, 0.0, 450.0]))


def reference_of(truth: TwinParameters, seed: int = 1, plan: Plan = PLAN) -> Reference:
    """What a bench with these parameters would have recorded; only its images are used."""
    twin = PlaneTwin(truth, seed)
    sessions = tuple(Remembered.of(twin, plan, pose) for pose in range(len(truth.poses)))
    return Reference(cast(Any, sessions), TARGET, cast(Any, _Known(truth)))


class _Known:
    """A characterisation that knows the poses."""

    def __init__(self, truth: TwinParameters) -> None:
        self.poses, self.board = truth.poses, TARGET.points()
        self.calibration = Calibration(CAMERA, PROJECTOR, PAIR, {"joint": 0.05})


@pytest.fixture(scope="module")
def truth() -> TwinParameters:
    return replace(
        nominal(tilted(4)), white=0.9, ink=0.08, ambient=0.03, response=Curve(a=0.92, b=0.08, g=1.03)
    )


@pytest.fixture(scope="module")
def reference(truth: TwinParameters) -> Reference:
    return reference_of(truth)


def loss(epsilon_d: float, whole: list[float], board: list[float]) -> Loss:
    return Loss(Weights(), 0.05 + epsilon_d, 0.05, Similarity(np.array(whole), np.array(board)))


def test_loss_agrees_with_the_paper() -> None:
    # The last row of the paper's table: SSIM 0.872 and 0.002 px make 0.103.
    found = loss(0.002, [0.872], [0.872])
    assert found.whole == pytest.approx(0.2 * np.log(1.002) + 0.8 * 0.128, rel=1e-12)
    assert loss(-0.002, [0.872], [0.872]).whole == pytest.approx(found.whole, rel=1e-12)


def test_loss_gives_mean_and_spread_over_the_images() -> None:
    summary = loss(0.0, [0.9, 0.7], [0.6, 0.2]).summary()
    assert summary["loss"] == pytest.approx(0.8 * 0.2)
    assert summary["loss_board"] == pytest.approx(0.8 * 0.6)
    assert summary["ssim_spread"] == pytest.approx(0.1)
    assert summary["loss_spread"] == pytest.approx(0.8 * 0.1)


def test_ssim_agrees_with_scikit_image() -> None:
    random = np.random.default_rng(0)
    a, b = random.integers(0, 255, (2, 60, 80)).astype(np.uint8)
    board = np.zeros((60, 80), bool)
    board[10:40, 20:60] = True
    whole, inside = ssim(a, b, 255, board)
    mean, every = structural_similarity(a.astype(float), b.astype(float), data_range=255, full=True)
    assert whole == pytest.approx(mean, abs=1e-5)
    assert inside == pytest.approx(every[board].mean(), abs=1e-5)
    assert ssim(a, a, 255, board) == pytest.approx((1.0, 1.0))


def test_board_mask_is_the_projected_outline_less_the_edge_margin() -> None:
    straight = replace(CAMERA, distortion=np.zeros(8))
    focal, (width, height) = 1216 / 450, TARGET.size_mm
    for margin in (0, 4, -3):
        found = board_mask(straight, FACING, TARGET, margin)
        sides = np.array([width, height]) * focal - 2 * margin
        assert found.sum() == pytest.approx(sides.prod(), rel=0.02)
        v, u = np.nonzero(found)
        assert (u.mean(), v.mean()) == pytest.approx((230, 150), abs=0.6)


@pytest.mark.nightly
def test_refinement_by_images_finds_the_geometry(truth: TwinParameters, reference: Reference) -> None:
    # The start is off by a tenth of a pixel; light and everything else is true.
    start = moved(truth, 0.04, 0.01)
    twin = PlaneTwin(start)
    held = replace(reference)
    for _ in range(2):
        twin = twin.with_parameters(geometry_fit.refine_by_images(held, twin, DistortionModel.K1))

    def places(parameters: TwinParameters) -> np.ndarray:
        known = parameters.calibration
        seen = [pose.apply(TARGET.points()) for pose in parameters.poses]
        camera = [known.camera.project(points) for points in seen]
        lit = [known.projector.project(points, known.T_projector_camera) for points in seen]
        return np.concatenate([*camera, *lit])

    before, after = (np.abs(places(p) - places(truth)).max() for p in (start, twin.parameters))
    assert before > 0.05
    assert after < 0.01


def test_jacobian_of_images_agrees_with_the_twin(truth: TwinParameters, reference: Reference) -> None:
    twin = PlaneTwin(truth)
    view = geometry_fit._residual_of_pose(reference, twin, 0)
    slopes = next(view.jacobian(truth, 5))
    move = np.zeros(6)
    move[3:] = 0.01, -0.01, 0.02
    there = geometry_fit._perturb_pose(geometry_fit.vectors_of(truth.poses[0]), move)
    twin = twin.with_parameters(replace(truth, poses=(geometry_fit.transform(there), *truth.poses[1:])))
    first = reference.finest_spread[:1]
    change = twin.expected_at(0, reference.shown(first), SETTINGS, view.pixels)[0] - view.expected[0]
    looked_at = view.level_gradient[0].any(axis=-1)
    predicted = slopes[:, 16:22] @ move
    rest = (change - predicted)[looked_at]
    # The plane twin interpolates mirrors bilinearly, so its derivatives jump from mirror to mirror.
    assert np.std(rest) < 0.1 * np.std(change[looked_at])


def test_displacement_of_the_board_in_one_image_is_found(truth: TwinParameters, reference: Reference) -> None:
    """A displacement of a third of a pixel, over which the level of an edge is not linear."""
    twin, move = PlaneTwin(replace(truth, vibration_mm=0.05)), np.array([0.06, -0.04, 0.03])
    view = geometry_fit._residual_of_pose(reference, twin, 0)
    slopes = next(view.jacobian(truth, 5))[:, 2 * 5 + 6 + 3 :]
    there = geometry_fit._perturb_pose(geometry_fit.vectors_of(truth.poses[0]), np.append(np.zeros(3), move))
    displaced = twin.with_parameters(replace(truth, poses=(geometry_fit.transform(there), *truth.poses[1:])))
    seen = displaced.expected_at(0, reference.shown(view.images[:1]), SETTINGS, view.pixels)[0]
    view.residual[0] = np.where(view.valid[0], seen - view.expected[0], 0.0)
    own, left = geometry_fit._remove_vibration(reference, twin, view, 0, slopes)
    assert np.all(np.abs(own - move) < [2e-3, 2e-3, 0.02])  # depth is known the least
    assert np.std(left) < 0.1 * np.std(view.residual[0])


def test_light_is_found(truth: TwinParameters, reference: Reference) -> None:
    twin = PlaneTwin(replace(truth, white=1.0, ink=0.05, ambient=0.01, projector_blur=0.9))
    samples = sample_pixels(reference, truth, (0, 2), reference.finest)
    found = light_fit.fit_light(reference, twin, ("white", "ink", "ambient", "projector_blur"), samples)
    assert found.white == pytest.approx(truth.white, rel=2e-3)
    assert found.ink == pytest.approx(truth.ink, rel=0.01)
    assert found.ambient == pytest.approx(truth.ambient, abs=2e-3)
    assert found.projector_blur == pytest.approx(truth.projector_blur, abs=0.03)


NOISY_PLAN = Plan(fringes=(Sinusoid(axis="x", stripes=12, steps=8), Sinusoid(axis="y", stripes=8, steps=8)))


def matched_noise(reference: Reference, twin: PlaneTwin) -> TwinParameters:
    """Noise and vibration of the bench, from three poses."""
    poses = (0, 1, 3)
    seen = [terms_of_pose(reference, twin, pose) for pose in poses]
    vibrating = with_vibration_of(twin.parameters, fit_fluctuation([pose.series(MOVES) for pose in seen]))
    twin = twin.with_parameters(vibrating)
    found = noise.match_noise(reference, twin, poses)
    assert twin.parameters is vibrating
    return found


@pytest.mark.nightly
def test_noise_is_found(truth: TwinParameters) -> None:
    noisy = replace(truth, vibration_mm=0.01, full_well_e=4000.0)
    twin = PlaneTwin(truth, 5)
    found = matched_noise(reference_of(noisy, 4, NOISY_PLAN), twin)
    # In the image plane eight frames of three poses have 42 degrees of freedom: 11 % is one deviation.
    assert found.vibration_mm == pytest.approx(0.01, rel=0.35)
    assert found.full_well_e == pytest.approx(4000.0, rel=0.1)
    # The read noise cannot be told beside rounding: in grey levels it stays.
    assert found.read_noise_e / found.full_well_e == pytest.approx(2.5 / 15000.0)


@pytest.mark.nightly
def test_what_the_twin_lacks_is_not_taken_for_noise(truth: TwinParameters) -> None:
    """A bent response that the twin does not know made a full well of 24 e for 15,000 by its residuals."""
    bent = replace(truth, response=Curve(a=0.92, b=0.08, g=1.6))
    found = matched_noise(reference_of(bent, 4, NOISY_PLAN), PlaneTwin(truth, 5))
    assert found.full_well_e == pytest.approx(truth.full_well_e, rel=0.1)


@pytest.mark.nightly
def test_great_read_noise_is_found(truth: TwinParameters) -> None:
    noisy = replace(truth, read_noise_e=600.0)
    found = matched_noise(reference_of(noisy, 4, NOISY_PLAN), PlaneTwin(truth, 5))
    assert found.read_noise_e == pytest.approx(600.0, rel=0.1)


@pytest.mark.nightly
def test_the_right_noise_is_the_best_and_images_are_compared_without_any(truth: TwinParameters) -> None:
    moving = replace(truth, vibration_mm=0.02)
    held = reference_of(moving, 4, NOISY_PLAN)

    def judged(vibration_mm: float) -> tuple[float, float]:
        twin = PlaneTwin(replace(truth, vibration_mm=vibration_mm), 8)
        alike = evaluate(held, twin, Weights(), 0.05).loss.similarity.board.mean()
        return float(np.sqrt(noise.noise_misfit(held, twin, (0, 1)).mean())), float(alike)

    (still, alike_still), (right, alike_right), (much, _) = (judged(mm) for mm in (0.0, 0.02, 0.08))
    assert right < 0.5 * min(still, much)
    assert alike_right == pytest.approx(alike_still)


def test_a_misfit_of_poses_grows_by_more_than_its_error_or_not_at_all() -> None:
    before = np.array([1.0, 2.0, 3.0, 4.0])
    assert is_worse(before, before + [0.3, 0.2, 0.3, 0.2])
    assert not is_worse(before, before + [0.9, -0.8, 0.7, -0.7])
    assert is_worse(1.0, 1.0 + 1e-9)
    assert not is_worse(1.0, 1.0)


def test_an_adjustable_parameter_is_clipped_to_its_range() -> None:
    knob = ADJUSTABLE["paper"]
    assert knob.read(knob.with_value(nominal(()), 1.7)) == 1.0


def response_of(truth: TwinParameters) -> Response:
    twin, shown = PlaneTwin(truth), np.linspace(0, 1, 6)
    from fpplab.patterns.fringes import uniform_patterns

    greys = uniform_patterns([round(255 * x) for x in shown], truth.calibration.projector.size)
    seen = twin.expected_of("grey_card", greys, SETTINGS).mean(axis=(1, 2)) / 255
    twin = twin.with_parameters(replace(truth, response=Curve(a=1, b=0, g=1)))
    dark = float(twin.expected_of("grey_card", greys[:1], SETTINGS).mean() / 255)
    return fit_response(np.rint(255 * shown) / 255, seen).model_copy(update={"dark": (dark, 1e-4)})


def test_gamma_is_matched(truth: TwinParameters) -> None:
    twin = PlaneTwin(nominal(truth.poses))
    found = match_gamma(twin, response_of(truth), "grey_card", SETTINGS)
    summary = found.summary()
    assert summary["sum_of_squares"] < 1e-7
    assert summary["W"] == pytest.approx(truth.white, rel=1e-3)
    assert summary["b"] == pytest.approx(truth.response.b, rel=0.01)
    assert summary["g"] == pytest.approx(truth.response.g, rel=1e-3)
    assert found.parameters is found.epochs[-1].parameters


def test_falloff_that_the_board_shows_leaves_the_level_of_the_card(truth: TwinParameters) -> None:
    bench = replace(truth, vignetting=4.0, projector_falloff=(0.1, 0.0, -0.3, 0.0, -0.3))
    twin, response = PlaneTwin(nominal(truth.poses)), response_of(bench)
    first = match_gamma(twin, response, "grey_card", SETTINGS).parameters
    assert first.white < 0.97 * bench.white
    paper = bench.white * bench.paper / first.white  # as the board then tells it
    sigma = {"paper": 0.01, "projector_blur": 0.02}
    twin = twin.with_parameters(replace(bench, white=first.white, paper=paper, ink=0.1 * paper, sigma=sigma))
    found = with_level_of_card(twin, response, "grey_card", SETTINGS)
    assert found.white == pytest.approx(bench.white, rel=1e-3)
    assert found.paper == pytest.approx(bench.paper, rel=1e-3)
    assert found.ink == pytest.approx(0.1 * found.paper)
    assert found.sigma["paper"] == pytest.approx(0.01 * bench.paper / paper, rel=1e-3)
    assert found.sigma["projector_blur"] == 0.02
    bright = replace(bench, white=0.5 * bench.white, paper=1.0)
    twin = twin.with_parameters(bright)  # the card asks for twice as much: a paper that reflects half
    assert with_level_of_card(twin, response, "grey_card", SETTINGS).paper == pytest.approx(0.5, rel=1e-3)


def test_a_response_that_the_twin_cannot_have_is_refused(truth: TwinParameters) -> None:
    response = response_of(truth)
    odd = [
        level.model_copy(update={"seen": 0.5 + 0.05 * (-1) ** k}) for k, level in enumerate(response.measured)
    ]
    with pytest.raises(CalibrationError, match="no response of the twin"):
        match_gamma(
            PlaneTwin(nominal(())),
            response.model_copy(update={"measured": tuple(odd)}),
            "grey_card",
            SETTINGS,
        )


def epoch(step: str, difference: float, accepted: bool = True) -> MatchingEpoch:
    parameters = ParametersFile.of(nominal(tilted(1)))
    return MatchingEpoch(
        epoch=0,
        step=step,
        accepted=accepted,
        loss={"loss": 0.1},
        difference=difference,
        seconds=1.0,
        parameters=parameters,
    )


def test_explained_shares_refer_to_the_difference_before_the_step() -> None:
    steps = [
        epoch("start", 4.0),
        epoch("depth of field", 2.0),
        epoch("vignetting", 3.0, False),
        epoch("ambient light", 1.0),
    ]
    found = explained_shares(steps)
    assert found["depth of field"] == pytest.approx(0.75)
    assert found["vignetting"] == 0.0
    assert found["ambient light"] == pytest.approx(0.75)


def test_one_pose_is_replaced_among_the_others() -> None:
    poses = tilted(4)
    known = nominal(poses)
    for i in range(4):
        assert known.with_pose(i, FACING).poses == (*poses[:i], FACING, *poses[i + 1 :])
    assert known.poses == poses


def test_epochs_are_read_back_as_they_were(tmp_path: Path, truth: TwinParameters) -> None:
    record = MatchingRecord(tmp_path)
    record.add(epoch("start", 4.0))
    record.add(epoch("points", 3.0).model_copy(update={"parameters": ParametersFile.of(truth)}))
    again = record.read()
    assert [e.step for e in again] == ["start", "points"]
    found = again[1].parameters.parameters()
    assert found.response == truth.response
    np.testing.assert_allclose(found.poses[2].matrix, truth.poses[2].matrix, atol=1e-12)
    np.testing.assert_allclose(found.calibration.camera.matrix, CAMERA.matrix)
    assert (found.ink, found.camera_focus_mm) == (truth.ink, None)


def test_poses_are_read_and_written_without_drift(truth: TwinParameters) -> None:
    """Light is kept by the exact poses: angles that change in their last digit would make all of it again."""
    random = np.random.default_rng(3)
    turns = [RigidTransform.from_vectors(turn, np.ones(3)) for turn in random.normal(0, 0.3, (40, 3))]
    written = ParametersFile.of(replace(truth, poses=tuple(turns)))
    assert ParametersFile.of(written.parameters()) == written


def test_an_incomplete_last_line_is_ignored(tmp_path: Path) -> None:
    record = MatchingRecord(tmp_path)
    record.add(epoch("start", 4.0))
    with (tmp_path / EPOCHS).open("ab") as stream:
        stream.write(b'{"epoch": 1, "st')
    assert len(record.read()) == 1
    record.add(epoch("points", 3.0))
    assert [e.step for e in record.read()] == ["start", "points"]


def test_a_damaged_record_names_its_line(tmp_path: Path) -> None:
    (tmp_path / EPOCHS).write_text('{"epoch": -1}\n')
    with pytest.raises(DataError, match="line 1: is no epoch"):
        MatchingRecord(tmp_path).read()


def test_another_camera_is_refused(truth: TwinParameters, reference: Reference) -> None:
    known = truth.calibration
    small = replace(known.camera, size=(228, 152))
    with pytest.raises(ConfigError, match="456 x 304 pixels, the twin's 228 x 152"):
        plausibility.check_devices(small.size, known.projector, reference.sessions[0])


def test_another_board_is_refused(truth: TwinParameters) -> None:
    other = config.validate(
        {**TARGET.model_dump(mode="json", exclude_none=True), "spacing_mm": [4.4, 9]}, type(TARGET), "other"
    )
    with pytest.raises(
        ConfigError, match=r"'spacing_mm' is \(4.4, 9.0\) but the twin's board has \(4.5, 9.0\)"
    ):
        plausibility.check_board(PlaneTwin(truth), other, "other.yaml")


def scaled(known: Calibration, factor: float) -> Calibration:
    pair = known.T_projector_camera
    return replace(known, T_projector_camera=RigidTransform(pair.rotation, factor * pair.translation))


def test_a_board_of_another_pitch_is_detected_by_the_baseline(truth: TwinParameters) -> None:
    known = truth.calibration
    plausibility.check_geometry(scaled(known, 1.05), known, Refusals())
    with pytest.raises(CalibrationError, match=r"baseline is .* another pitch.*--accept stale_calib"):
        plausibility.check_geometry(scaled(known, 1.2), known, Refusals())


def test_what_is_accepted_is_noted(truth: TwinParameters) -> None:
    refusals = Refusals(acceptable_causes(["stale_calibration"]))
    plausibility.check_geometry(scaled(truth.calibration, 1.2), truth.calibration, refusals)
    (note,) = refusals.notes
    assert note.startswith("stale_calibration accepted: the baseline is")
    with pytest.raises(CalibrationError, match="unlike"):
        refusals.refuse(UNLIKE_IMAGES, "unlike")
    with pytest.raises(ConfigError, match="--accept: 'vibration' is no cause that can be accepted"):
        acceptable_causes(["vibration"])


def test_a_focus_that_moved_is_found(truth: TwinParameters, reference: Reference) -> None:
    assert plausibility.sharpness_finding(reference, PlaneTwin(truth)) is None
    blurred = PlaneTwin(replace(truth, camera_focus_mm=400.0, f_number=3.0), 2)
    sessions = (*reference.sessions[:3], cast(Any, Remembered.of(blurred, PLAN, 3)))
    found = plausibility.sharpness_finding(replace(reference, sessions=sessions), PlaneTwin(truth))
    assert found is not None
    assert found.cause == LENS_NOT_LOCKED
    assert re.search(r"pose_03: at the same brightness its edges are .* softer", found.evidence)


def test_a_darker_pose_is_not_taken_for_another_focus(truth: TwinParameters, reference: Reference) -> None:
    """A lamp that is a third weaker, and light that falls off by as much over the board."""
    seen = [Remembered.of(PlaneTwin(truth, 2), PLAN, pose) for pose in range(len(reference.sessions))]
    fall = np.linspace(0.5, 0.8, CAMERA.size[0])
    dark = replace(seen[3], images=[np.rint(fall * image).astype(np.uint8) for image in seen[3].images])
    other = replace(reference, sessions=cast(Any, (*seen[:3], dark)))
    contrasts = plausibility.edge_contrast(other, PlaneTwin(truth))
    assert np.abs(contrasts / np.median(contrasts) - 1).max() < 0.03
    assert plausibility.sharpness_finding(other, PlaneTwin(truth)) is None


def test_blur_of_all_poses_alike_is_accepted(truth: TwinParameters, reference: Reference) -> None:
    twin = PlaneTwin(truth, 2)
    seen = [Remembered.of(twin, PLAN, pose) for pose in range(len(reference.sessions))]
    blurred = [replace(s, images=[cv2.GaussianBlur(i, (0, 0), 1.0) for i in s.images]) for s in seen]
    softer = replace(reference, sessions=cast(Any, tuple(blurred)))
    most = 1 - plausibility.LIMITS.max_contrast_difference
    assert plausibility.edge_contrast(softer, PlaneTwin(truth)).max() < most
    assert plausibility.sharpness_finding(softer, PlaneTwin(truth)) is None


def test_a_result_of_low_similarity_is_useless() -> None:
    assert plausibility.similarity_finding(0.95, 1.0) is None
    found = plausibility.similarity_finding(0.5, 20.0)
    assert found is not None
    assert found.evidence.startswith("SSIM over the board is 0.500")
    assert found.excess >= plausibility.LIMITS.max_image_difference


def test_the_response_of_another_rig_is_refused_before_the_work(truth: TwinParameters) -> None:
    wide = Plan(fringes=(Sinusoid(axis="x", stripes=3, steps=6),))
    twin = PlaneTwin(replace(truth, response=Curve(a=0.95, b=0.05, g=1.8)))
    sessions = cast(Any, [Remembered.of(twin, wide, pose) for pose in range(3)])

    def response(g: float) -> Response:
        return fit_response(np.linspace(0, 1, 9), 0.7 * np.linspace(0, 1, 9) ** g + 0.05)

    plausibility.check_second_harmonic(response(1.8), sessions, Refusals())
    with pytest.raises(CalibrationError, match=r"second harmonic .* is 2.*, but 7.7 % by the response"):
        plausibility.check_second_harmonic(response(1.25), sessions, Refusals())


def test_the_card_is_put_where_its_scan_shows_it() -> None:
    random = np.random.default_rng(5)
    pose = RigidTransform.from_vectors(np.radians([4.0, -6.0, 0.0]), np.array([1.0, 2.0, 454.0]))
    flat = np.column_stack([random.uniform(-60, 60, (4000, 2)), random.normal(0, 0.02, 4000)])
    flat[:200, 2] += 30.0  # something that stands before it
    centre, normal, spread = fitted_plane(pose.apply(flat))
    nominal_pose = RigidTransform(np.eye(3), np.array([0.0, 0.0, 450.0]))
    found = moved_into_plane(nominal_pose, centre, normal)
    assert spread < 0.03
    off = pose.inverse().apply(found.apply(np.array([[-50.0, -40, 0], [50, -40, 0], [0, 40, 0]])))
    assert np.abs(off[:, 2]).max() < 0.01
    turned = np.degrees(np.linalg.norm((found @ nominal_pose.inverse()).rotation_vector))
    assert turned == pytest.approx(np.hypot(4, 6), abs=0.1)


def test_a_round_that_still_moves_poses_has_not_converged(truth: TwinParameters) -> None:
    limits = MatchingLimits()
    now = replace(truth, sigma={"poses_um": 4.0, "white": 0.002})
    before = epoch("together", 1.0).model_copy(
        update={"loss": {"loss_board": 0.1}, "parameters": ParametersFile.of(now)}
    )

    def after(parameters: TwinParameters) -> MatchingEpoch:
        return before.model_copy(update={"parameters": ParametersFile.of(parameters)})

    assert not match._has_changed(before, after(now), limits)
    assert not match._has_changed(before, after(moved(now, 0.004, 0.0)), limits)
    assert match._has_changed(before, after(moved(now, 0.02, 0.0)), limits)
    uncertain = replace(moved(now, 0.02, 0.0), sigma={"poses_um": 50.0})
    assert not match._has_changed(before, after(uncertain), limits)
    assert match._has_changed(before, after(replace(now, white=now.white + 0.01)), limits)
    assert not match._has_changed(before, after(replace(now, white=now.white + 0.001)), limits)


def test_steps_are_repeated_while_they_change_something(truth: TwinParameters) -> None:
    now = replace(truth, sigma={"poses_um": 4.0})

    def made(step: str, parameters: TwinParameters) -> MatchingEpoch:
        made = {"loss": {"loss_board": 0.1}, "parameters": ParametersFile.of(parameters)}
        return epoch(step, 1.0).model_copy(update=made)

    steps = [step for step in match.REPEATED_STEPS if step.name in ("together", "images")]
    epochs = [made("start", now), made("together", now), made("images", moved(now, 0.02, 0.0))]
    assert match._worth_trying(steps, epochs[:1], MatchingLimits()) == steps
    assert [step.name for step in match._worth_trying(steps, epochs, MatchingLimits())] == ["images"]


@pytest.mark.nightly
def test_standard_uncertainties_of_light_cover_the_truth(truth: TwinParameters) -> None:
    names = ("white", "ink", "ambient", "projector_blur")
    pulls = []
    for seed in range(3):
        twin = PlaneTwin(replace(truth, white=1.0, projector_blur=0.8))
        held = reference_of(truth, 10 + seed)
        samples = sample_pixels(held, truth, (0, 2), held.finest)
        found = light_fit.fit_light(held, twin, names, samples)
        pulls.append([(getattr(found, n) - getattr(truth, n)) / found.sigma[n] for n in names])
    assert np.abs(pulls).max() < 5
    # Rounding and noise of a whole image leave little: a stated uncertainty far too great would tell nothing.
    assert np.sqrt(np.mean(np.square(pulls))) > 0.1
