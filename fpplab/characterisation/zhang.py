"""Characterisation of a camera and a projector from poses of a board.

Zhang's method for each device, then the pose between them, then everything together
(`fpplab.characterisation.bundle`). RMS figures are per point: the root of the mean squared distance in px.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from fpplab.calibration import Calibration
from fpplab.characterisation.bundle import INTRINSICS, Solution, adjust, fit_pose, vectors_of
from fpplab.characterisation.observation import Observation
from fpplab.conventions import Floats, Lattice
from fpplab.errors import CalibrationError
from fpplab.geometry import Pinhole, RigidTransform
from fpplab.targets import Target

LEAST_POSES = 3
"""Zhang's method needs this many tilted poses when nothing of the device is known."""

ODD_POSE = 4.0
"""A pose this many times worse than the median of all is not of the same board, rig and focus."""

WORST_FOCAL = 0.03
"""Greatest relative uncertainty of a focal length that deserves the name of a result."""

Size = tuple[int, int]
Pixels = list[Floats]


@dataclass(frozen=True, eq=False)
class Characterisation:
    """A calibration with all that is known about how good it is.

    observations: the poses used; residuals are in their order, model minus observation, (K, 2) px.
    poses: `T_camera_target` of each. apart_px: RMS of `camera` and `projector` fitted apart, and
    of the `stereo` step on top. leave_one_out_px: RMS of `camera` and `projector` in poses that
    the devices were not fitted to; None with too few poses. board: points (P, 3) in mm as used.
    left_out: why, by name of pose. sigma: standard uncertainty, as `camera.fx` or
    `T_projector_camera.x`, in px, rad or mm.
    """

    calibration: Calibration
    observations: tuple[Observation, ...]
    poses: tuple[RigidTransform, ...]
    camera_residuals: tuple[Floats, ...]
    projector_residuals: tuple[Floats, ...]
    apart_px: dict[str, float]
    leave_one_out_px: dict[str, float] | None
    board: Floats
    left_out: dict[str, str]
    sigma: dict[str, float]

    @property
    def points(self) -> int:
        """How many points were used, all poses together."""
        return sum(len(o.ids) for o in self.observations)

    def summary(self) -> dict[str, Any]:
        """The figures for a machine to read, as the command line prints them."""
        rms = self.calibration.rms_px
        return {
            "camera": {"rms_px": rms["camera"]},
            "projector": {"rms_px": rms["projector"]},
            "joint_rms_px": rms["joint"],
            "stereo_rms_px": self.apart_px["stereo"],
            "leave_one_out": {
                f"{d}_px": (self.leave_one_out_px or {}).get(d) for d in ("camera", "projector")
            },
            "poses": len(self.observations),
            "points": self.points,
        }

    @property
    def pose_rms_px(self) -> dict[str, dict[str, float]]:
        """RMS of `camera` and `projector` by name of pose."""
        pairs = zip(self.observations, self.camera_residuals, self.projector_residuals, strict=True)
        return {o.name: {"camera": _rms([c]), "projector": _rms([p])} for o, c, p in pairs}


def characterise(
    observations: Sequence[Observation],
    target: Target,
    camera_size: Size,
    projector_size: Size,
    lattice: Lattice = Lattice.SQUARE,
    *,
    left_out: Mapping[str, str] | None = None,
    k3: bool = False,
) -> Characterisation:
    """Both devices and the pose between them, from what `observe` made of each pose.

    camera_size, projector_size: (width, height) in px. left_out: the poses that could not be
    observed, with a sentence each that names the pose and says why. k3: free the third radial term.

    With `target.tolerance_mm` the board's own shape is fitted too, held by that tolerance.

    Raises `CalibrationError` when fewer than `LEAST_POSES` poses can be used, naming why each of
    the others cannot, and when the poses do not determine the devices.
    """
    missing = dict(left_out or {})
    observations = list(observations)
    while True:
        _enough(observations, missing)
        start, apart = _apart(observations, target.points(), camera_size, projector_size)
        odd = _odd_pose(observations, start, 5.0)
        if odd is None:
            pair, apart["stereo"] = _stereo(observations, start, camera_size)
            solution, sigma = adjust(
                observations, replace(start, T_projector_camera=pair), k3, target.tolerance_mm
            )
            odd = _odd_pose(observations, solution, 1.0)
        if odd is None:
            break
        missing[observations[odd].name] = (
            f"{observations[odd].name}: fits {ODD_POSE:g} times worse than the other poses; "
            "the board or the rig moved during the capture"
        )
        del observations[odd]
    uncertainty = _named(sigma, k3)
    _determined(solution, uncertainty)
    residuals = [solution.residuals(i, o) for i, o in enumerate(observations)]
    cameras, projectors = zip(*residuals, strict=True)
    rms = {"camera": _rms(cameras), "projector": _rms(projectors), "joint": _rms(cameras + projectors)}
    calibration = Calibration(
        _pinhole(solution.camera, camera_size, Lattice.SQUARE),
        _pinhole(solution.projector, projector_size, lattice),
        _transform(solution.T_projector_camera),
        rms,
    )
    return Characterisation(
        calibration,
        tuple(observations),
        tuple(_transform(p) for p in solution.poses),
        cameras,
        projectors,
        apart,
        _leave_one_out(observations, solution, target, k3),
        solution.board,
        missing,
        uncertainty,
    )


def _enough(observations: Sequence[Observation], left_out: dict[str, str]) -> None:
    if len(observations) >= LEAST_POSES:
        return
    why = f" ({'; '.join(left_out.values())})" if left_out else ""
    raise CalibrationError(
        f"only {len(observations)} of {len(observations) + len(left_out)} poses can be used, "
        f"at least {LEAST_POSES} are needed{why}; capture more poses, each tilted differently"
    )


def _determined(solution: Solution, sigma: dict[str, float]) -> None:
    """Refuse focal lengths that the poses leave open: `CalibrationError`."""
    for device in ("camera", "projector"):
        for index, term in enumerate(("fx", "fy")):
            focal, doubt = getattr(solution, device)[index], sigma[f"{device}.{term}"]
            if doubt > WORST_FOCAL * focal:
                raise CalibrationError(
                    f"the {device}'s focal length is {focal:.0f} ± {doubt:.0f} px: the poses do not "
                    "determine it; add some that are tilted by 20° or more"
                )


def _apart(
    observations: Sequence[Observation], board: Floats, camera_size: Size, projector_size: Size
) -> tuple[Solution, dict[str, float]]:
    """Each device by itself, and a first pose between them that the most poses agree on."""
    boards = [board[o.ids] for o in observations]
    camera_rms, camera, poses = _zhang("camera", boards, [o.camera_px for o in observations], camera_size)
    projector_rms, projector, lit = _zhang(
        "projector", boards, [o.projector_px for o in observations], projector_size
    )
    solutions = [
        Solution(camera, projector, vectors_of(_transform(p) @ _transform(c).inverse()), poses, board)
        for c, p in zip(poses, lit, strict=True)
    ]
    agreed = min(solutions, key=lambda s: float(np.median(_rms_of_poses(observations, s))))
    return agreed, {"camera": camera_rms, "projector": projector_rms}


def _zhang(device: str, boards: Pixels, pixels: Pixels, size: Size) -> tuple[float, Floats, Floats]:
    """Zhang's method from several guesses of the principal point: RMS, intrinsics (9,), poses (M, 6).

    A projector's lens is often shifted so far that its principal point lies at the picture's edge,
    where a start from the centre may end in a wrong minimum.
    """
    width, height = size
    places = ((0.5, 0.5), (0.5, 1.0), (0.5, 0.0), (1.0, 0.5), (0.0, 0.5))
    guesses = [(across * (width - 1), down * (height - 1)) for across, down in places]
    fits = [fit for guess in guesses if (fit := _zhang_from(guess, boards, pixels, size)) is not None]
    if not fits:
        raise CalibrationError(
            f"the poses do not determine the {device}; tilt the board by 20° or more, each time differently"
        )
    return min(fits, key=lambda fit: fit[0])


def _zhang_from(
    guess: tuple[float, float], boards: Pixels, pixels: Pixels, size: Size
) -> tuple[float, Floats, Floats] | None:
    flat = [b.astype(np.float32) for b in boards]
    seen = [p.astype(np.float32) for p in pixels]
    centre = 0.5 * (np.array(size) - 1)
    moved = [(p - guess + centre).astype(np.float32) for p in pixels]
    matrix: Any = np.asarray(cv2.initCameraMatrix2D(flat, moved, size, 0), np.float64)
    matrix[:2, 2] = guess
    focal = matrix[[0, 1], [0, 1]]
    if not np.all(np.isfinite(focal)) or focal.min() <= 0:
        # The closed form fails for a wrong guess or small tilts; Zhang's iteration often does not.
        matrix[[0, 1], [0, 1]] = 2.0 * max(size)
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
    try:
        rms, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            flat, seen, size, matrix, np.zeros(5), flags=flags
        )
    except cv2.error:
        return None
    intrinsics = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()[:5]])
    poses = np.hstack([np.array(turns).reshape(-1, 3), np.array(shifts).reshape(-1, 3)])
    sound = np.isfinite(rms) and np.all(np.isfinite(intrinsics)) and intrinsics[:2].min() > 0
    return (float(rms), intrinsics, poses) if sound and poses[:, 5].min() > 0 else None


def _stereo(observations: Sequence[Observation], start: Solution, size: Size) -> tuple[Floats, float]:
    """The best T_projector_camera (6,) with both devices held, and the RMS of both together."""
    rms, *_, rotation, translation, _, _ = cv2.stereoCalibrate(
        [start.board[o.ids].astype(np.float32) for o in observations],
        [o.camera_px.astype(np.float32) for o in observations],
        [o.projector_px.astype(np.float32) for o in observations],
        _matrix(start.camera),
        start.camera[4:],
        _matrix(start.projector),
        start.projector[4:],
        size,
        flags=cv2.CALIB_FIX_INTRINSIC,
    )
    pair = RigidTransform(np.asarray(rotation, np.float64), np.asarray(translation, np.float64).ravel())
    return vectors_of(pair), float(rms)


def _rms_of_poses(observations: Sequence[Observation], solution: Solution) -> Floats:
    return np.array([_rms(solution.residuals(i, o)) for i, o in enumerate(observations)])


def _odd_pose(observations: Sequence[Observation], solution: Solution, least_px: float) -> int | None:
    """The pose that fits so much worse than the rest that something moved while it was captured."""
    rms = _rms_of_poses(observations, solution)
    worst = int(np.argmax(rms))
    return worst if rms[worst] > max(ODD_POSE * float(np.median(rms)), least_px) else None


def _leave_one_out(
    observations: Sequence[Observation],
    solution: Solution,
    target: Target,
    k3: bool,
) -> dict[str, float] | None:
    """RMS in each pose when the devices are fitted to the others, and only its pose to it."""
    if len(observations) <= LEAST_POSES:
        return None
    cameras, projectors = [], []
    for held, observation in enumerate(observations):
        others = [o for i, o in enumerate(observations) if i != held]
        start = replace(solution, poses=np.delete(solution.poses, held, axis=0), board=target.points())
        trained, _ = adjust(others, start, k3, target.tolerance_mm)
        pose = fit_pose(observation, trained, solution.poses[held])
        camera, projector = replace(trained, poses=pose[None]).residuals(0, observation)
        cameras.append(camera)
        projectors.append(projector)
    return {"camera": _rms(cameras), "projector": _rms(projectors)}


def _rms(residuals: Sequence[Floats]) -> float:
    return float(np.sqrt(np.mean(np.sum(np.concatenate(list(residuals)) ** 2, axis=1))))


def _matrix(intrinsics: Floats) -> Floats:
    fx, fy, cx, cy = intrinsics[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def _pinhole(intrinsics: Floats, size: Size, lattice: Lattice) -> Pinhole:
    return Pinhole(size, _matrix(intrinsics), intrinsics[4:], lattice)


def _transform(vectors: Floats) -> RigidTransform:
    return RigidTransform.from_vectors(vectors[:3], vectors[3:])


def _named(sigma: Floats, k3: bool) -> dict[str, float]:
    """The uncertainties of the devices and of the pose between them, by name."""
    terms = INTRINSICS if k3 else INTRINSICS[:-1]
    names = [f"{device}.{term}" for device in ("camera", "projector") for term in terms]
    names += [f"T_projector_camera.{axis}" for axis in ("rx", "ry", "rz", "x", "y", "z")]
    return dict(zip(names, sigma.tolist(), strict=False))
