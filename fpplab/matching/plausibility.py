"""Twins that cannot become the bench, told by name instead of matched to nonsense."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.matching.loss import Loss, board_mask
from fpplab.matching.reference import Reference
from fpplab.sessions.session import Session
from fpplab.simulation.matchable import Twin
from fpplab.targets import Target
from fpplab.targets.kinds import OWN_FIELDS

APART = {"camera's focal length": 0.1, "projector's focal length": 0.1, "baseline": 0.1}
"""Relative difference between what was found and the twin's own file beyond which one is not the other."""
TURNED_DEG = 10.0
SHARPER = 0.12
"""Relative difference of edge contrast, bench to twin, between poses, that no matched focus leaves."""
EDGE = 0.3
"""Share of the steepest gradient from which a pixel lies on an edge."""
ALIKE = 0.8
"""SSIM over the board under which nothing has been matched."""


def check_devices(twin: Twin, session: Session) -> None:
    """Refuse a session of another camera or projector: `ConfigError` that says which."""
    known = twin.parameters.calibration
    width, height, _ = session.format
    size, lattice = session.projector()
    if (width, height) != known.camera.size:
        raise ConfigError(
            f"{session.path}: the bench's camera has {width} x {height} pixels, the twin's "
            f"{known.camera.size[0]} x {known.camera.size[1]}; name this bench's twin, or set its binning"
        )
    if size != known.projector.size or lattice is not known.projector.lattice:
        raise ConfigError(
            f"{session.path}: the bench's projector has {size[0]} x {size[1]} mirrors, {lattice}, the twin's "
            f"{known.projector.size[0]} x {known.projector.size[1]}, {known.projector.lattice}; name this "
            "bench's twin"
        )


def check_board(twin: Twin, target: Target, source: str) -> None:
    """Refuse a target that is not the twin's board: `ConfigError` that names the first field that differs."""
    own = twin.target
    for name in ("kind", "counts", "spacing_mm", *OWN_FIELDS, "size_mm"):
        if (given := getattr(target, name)) != (has := getattr(own, name)):
            raise ConfigError(
                f"{source}: '{name}' is {given} but the twin's board has {has}; give both the same board"
            )


def check_near(found: Calibration, nominal: Calibration) -> None:
    """Refuse a bench that is far from what the twin's file says: `CalibrationError`.

    A board of another pitch changes nothing in its pictures but the scale: it is found out by the baseline.
    """
    pairs = {
        "camera's focal length": (found.camera.matrix[0, 0], nominal.camera.matrix[0, 0], "px"),
        "projector's focal length": (found.projector.matrix[0, 0], nominal.projector.matrix[0, 0], "px"),
        "baseline": (found.baseline_mm, nominal.baseline_mm, "mm"),
    }
    for name, (is_, should, unit) in pairs.items():
        if abs(is_ / should - 1.0) > APART[name]:
            why = (
                "the board has another pitch than its target file says, or the devices stand elsewhere"
                if name == "baseline"
                else "another lens, or another binning"
            )
            raise CalibrationError(
                f"the {name} is {is_:.4g} {unit} on the bench and {should:.4g} {unit} in the twin: {why}"
            )
    turn = found.T_projector_camera.rotation @ nominal.T_projector_camera.rotation.T
    angle = float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))
    if angle > TURNED_DEG:
        raise CalibrationError(
            f"the projector is turned by {angle:.1f}° against the twin's: its pose in the twin's file is "
            "wrong, or one of the pictures is mirrored or turned"
        )


def check_sharpness(bench: Reference, twin: Twin) -> None:
    """Refuse a bench whose focus moved between poses: `CalibrationError` that names the worst.

    For the matched twin: each pose's edges must be as steep as the twin's, relative to the other poses: what
    softens all of them alike is the bench's lens or print, and no focus that moved.
    """
    contrasts = edge_contrast(bench, twin)
    usual = float(np.median(contrasts))
    worst = int(np.argmax(np.abs(np.log(contrasts / usual))))
    off = float(contrasts[worst]) / usual - 1.0
    if abs(off) <= SHARPER:
        return
    word, name = "softer" if off < 0 else "sharper", bench.sessions[worst].path.name
    raise CalibrationError(
        f"{name}: its edges are {100 * abs(off):.0f} % {word} beside the matched twin's than those of the "
        "other poses, and no focus or aperture explains all: the bench's focus moved, or the board did; take "
        "the poses again"
    )


def edge_contrast(bench: Reference, twin: Twin) -> Floats:
    """Of every pose, how steep edges and fringes are on the bench, relative to the twin; (M,)."""
    images = bench.finest[:2]
    return np.array([_contrast(bench, twin, pose, images) for pose in range(len(twin.parameters.poses))])


def _contrast(bench: Reference, twin: Twin, pose: int, images: Sequence[int]) -> float:
    now = twin.parameters
    board = board_mask(now.calibration.camera, now.poses[pose], bench.target)
    seen = twin.expected(pose, bench.shown(images), bench.settings)
    real = bench.frames(pose, images)
    products, squares = 0.0, 0.0
    for there, here in zip(real, seen, strict=True):
        for axis in ((1, 0), (0, 1)):
            a, b = (
                cv2.Sobel(one, cv2.CV_32F, *axis, ksize=3)[board].astype(np.float64) for one in (there, here)
            )
            edge = np.abs(b) > EDGE * np.abs(b).max()
            products, squares = products + float(a[edge] @ b[edge]), squares + float(b[edge] @ b[edge])
    return products / max(squares, 1e-12)


def check_alike(loss: Loss, unexplained: float) -> None:
    """Refuse an end that is no match: `CalibrationError`."""
    alike = float(loss.similarity.board.mean())
    if alike < ALIKE:
        raise CalibrationError(
            f"the twin does not become the bench: SSIM over the board is {alike:.3f} at best, and "
            f"{ALIKE:g} is the least; {unexplained:.1f} levels of difference are left"
        )
