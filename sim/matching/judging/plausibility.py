"""Plausibility checks of a matching: a twin that cannot match the bench is refused with the reason.

What recordings show is checked before the work starts; what only the matched twin shows is a finding.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Floats, Mask
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import Pinhole
from fpplab.devices import ProjectorCaps
from fpplab.diagnosis import Finding
from fpplab.diagnosis.causes.of_characterisation import LENS_NOT_LOCKED
from fpplab.diagnosis.causes.of_matching_and_search import UNLIKE_IMAGES
from fpplab.diagnosis.causes.response import RESPONSE
from fpplab.diagnosis.causes.stale_calibration import STALE_CALIBRATION
from fpplab.patterns.phase_error import relative_harmonics
from fpplab.patterns.response import Response
from fpplab.phase.error_model import error_model_of
from fpplab.sessions.session import Session
from fpplab.targets import Target
from fpplab.targets.kinds import OWN_FIELDS
from sim.matching.loss import board_mask
from sim.matching.reference import Reference
from sim.matching.refusal import Refusals
from sim.twin import Twin

MAX_RELATIVE_DIFFERENCE = {"camera's focal length": 0.1, "projector's focal length": 0.1, "baseline": 0.1}
"""Greatest relative difference between what was found and the twin's own file."""


@dataclass(frozen=True)
class PlausibilityLimits:
    """What a bench and its twin may differ by."""

    max_rotation_deg: float = 10.0  # of the projector against that of the file (chosen)
    max_contrast_difference: float = 0.12  # of edges, relative, that a matched focus leaves (chosen)
    min_edge_gradient: float = 0.3  # share of the steepest gradient on an edge (chosen)
    brightness_share: float = 0.1  # of the board's side: width over which brightness is averaged (chosen)
    min_ssim: float = 0.8  # over the board (chosen)
    max_image_difference: float = 3.0  # excess from which the twin must not be used (chosen)
    max_harmonic_difference: float = 0.02  # of the fringe; 0.06 of an exponent near 1 (derived)


LIMITS = PlausibilityLimits()


def check_devices(camera: tuple[int, int], projector: Pinhole | ProjectorCaps, session: Session) -> None:
    """Refuse a session of another camera, by its size, or of another projector than the twin's."""
    width, height, _ = session.format
    size, lattice = session.projector()
    if (width, height) != camera:
        raise ConfigError(
            f"{session.path}: the bench's camera has {width} x {height} pixels, the twin's "
            f"{camera[0]} x {camera[1]}; name this bench's twin, or set its binning"
        )
    if (size, lattice) != (projector.size, projector.lattice):
        raise ConfigError(
            f"{session.path}: the bench's projector has {size[0]} x {size[1]} mirrors, {lattice}, the twin's "
            f"{projector.size[0]} x {projector.size[1]}, {projector.lattice}; name this bench's twin"
        )


def check_board(twin: Twin, target: Target, source: str) -> None:
    """Refuse a target that is not the twin's board."""
    own = twin.target
    for name in ("kind", "counts", "spacing_mm", *OWN_FIELDS, "size_mm"):
        if (value := getattr(target, name)) != (has := getattr(own, name)):
            raise ConfigError(
                f"{source}: '{name}' is {value} but the twin's board has {has}; give both the same board"
            )


def check_geometry(measured: Calibration, nominal: Calibration, refusals: Refusals) -> None:
    """Refuse a bench whose geometry is far from that of the twin's file."""
    # A board of another pitch changes only the scale of the scene, not its images: the baseline shows it.
    pairs = {
        "camera's focal length": (measured.camera.matrix[0, 0], nominal.camera.matrix[0, 0], "px"),
        "projector's focal length": (measured.projector.matrix[0, 0], nominal.projector.matrix[0, 0], "px"),
        "baseline": (measured.baseline_mm, nominal.baseline_mm, "mm"),
    }
    for name, (is_, should, unit) in pairs.items():
        if abs(is_ / should - 1.0) > MAX_RELATIVE_DIFFERENCE[name]:
            why = (
                "the board has another pitch than its target file says, or the devices stand elsewhere"
                if name == "baseline"
                else "another lens, or another binning"
            )
            message = (
                f"the {name} is {is_:.4g} {unit} on the bench and {should:.4g} {unit} in the twin: {why}"
            )
            refusals.refuse(STALE_CALIBRATION, message)
    turn = measured.T_projector_camera.rotation @ nominal.T_projector_camera.rotation.T
    angle = float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))
    if angle > LIMITS.max_rotation_deg:
        refusals.refuse(
            STALE_CALIBRATION,
            f"the projector is turned by {angle:.1f}° against the twin's: its pose in the twin's file is "
            "wrong, or one of the pictures is mirrored or turned",
        )


def check_second_harmonic(response: Response, sessions: Sequence[Session], refusals: Refusals) -> None:
    # The fringes on the board are bent by the response: the second harmonic of the widest set of at least
    # four images shows it without any twin.
    plan = sessions[0].plan.fringe_part
    wide = [k for k, fringe in enumerate(plan.fringes) if fringe.images > 3] if plan else []
    if plan is None or not wide:
        return
    widest = min(wide, key=lambda k: plan.fringes[k].stripes)
    parts = [session.recording(verify=False).fringe_part for session in sessions]
    recordings = [replace(part, response=None) for part in parts if part is not None]
    measured = float(np.median([error_model_of(session).sets[widest].harmonics[0] for session in recordings]))
    should = float(relative_harmonics(response, plan.response, 2)[2])
    if not abs(measured - should) <= LIMITS.max_harmonic_difference:
        refusals.refuse(
            RESPONSE,
            f"the second harmonic of the fringes on the board is {100 * measured:.1f} % of the fringe, but "
            f"{100 * should:.1f} % by the response file: it is another rig's, or the projector's gamma was "
            "changed; measure it again with `fpplab gamma`",
        )


def sharpness_finding(reference: Reference, twin: Twin) -> Finding | None:
    """Find a pose that was taken with another focus than the others."""
    # Each pose's edges must be as steep as the twin's, at the same brightness, relative to the other poses:
    # what softens all of them equally is the bench's lens or print, not a focus that moved.
    contrasts = edge_contrast(reference, twin)
    usual = float(np.median(contrasts))
    worst = int(np.argmax(np.abs(np.log(contrasts / usual))))
    off = float(contrasts[worst]) / usual - 1.0
    if abs(off) <= LIMITS.max_contrast_difference:
        return None
    word, name = "softer" if off < 0 else "sharper", reference.sessions[worst].path.name
    evidence = (
        f"{name}: at the same brightness its edges are {100 * abs(off):.0f} % {word}, relative to the "
        f"matched twin's, than those of the other poses (at most {100 * LIMITS.max_contrast_difference:.0f} "
        "%): the bench's focus moved, or the board moved"
    )
    return Finding(LENS_NOT_LOCKED, evidence, abs(off) / LIMITS.max_contrast_difference)


def edge_contrast(reference: Reference, twin: Twin) -> Floats:
    """Compare how steep edges and fringes are on the bench and in the twin."""
    # returns (M,)
    images = reference.finest[:2]
    return np.array([_contrast(reference, twin, pose, images) for pose in range(len(twin.parameters.poses))])


def _contrast(reference: Reference, twin: Twin, pose: int, images: Sequence[int]) -> float:
    now = twin.parameters
    whole = board_mask(now.calibration.camera, now.poses[pose], reference.target)
    x, y, width, height = cv2.boundingRect(whole.astype(np.uint8))
    part = np.s_[y : y + height, x : x + width]
    board = whole[part]
    share = _mean_nearby(np.ones(board.shape, np.float32), board)
    expected = reference.evened(
        twin.expected(pose, reference.shown(images), reference.settings), now.black_level
    )
    real = reference.evened(reference.frames(pose, images), now.black_level)
    products, squares = 0.0, 0.0
    for pair in zip(real, expected, strict=True):
        on_bench, on_twin = (_at_even_brightness(image[part], board, share) for image in pair)
        for axis in ((1, 0), (0, 1)):
            a, b = (
                cv2.Sobel(image, cv2.CV_32F, *axis, ksize=3)[board].astype(np.float64)
                for image in (on_bench, on_twin)
            )
            edge = np.abs(b) > LIMITS.min_edge_gradient * np.abs(b).max()
            products, squares = products + float(a[edge] @ b[edge]), squares + float(b[edge] @ b[edge])
    return products / max(squares, 1e-12)


def _mean_nearby(image: NDArray[np.float32], board: Mask) -> NDArray[np.float32]:
    """Mean over the neighbourhood of each pixel, with nothing where the board is not."""
    width = LIMITS.brightness_share * float(np.sqrt(board.sum()))
    inside = image * board.astype(np.float32)
    return np.asarray(cv2.GaussianBlur(inside, (0, 0), width, borderType=cv2.BORDER_CONSTANT), np.float32)


def _at_even_brightness(
    image: NDArray[np.float32], board: Mask, share: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Divide an image by the mean level of its neighbourhood on the board, `share` of which is board."""
    level = _mean_nearby(image, board)
    return np.asarray(image * share / np.maximum(level, 1e-3 * level.max()), np.float32)


def similarity_finding(ssim: float, unexplained: float) -> Finding | None:
    """Find that a matching's result is not similar to the reference."""
    if ssim >= LIMITS.min_ssim:
        return None
    evidence = (
        f"SSIM over the board is {ssim:.3f} at best, but at least {LIMITS.min_ssim:g} is needed; "
        f"{unexplained:.1f} levels of difference are left"
    )
    return Finding(
        UNLIKE_IMAGES, evidence, LIMITS.max_image_difference * (1.0 - ssim) / (1.0 - LIMITS.min_ssim)
    )
