"""Calibrations that no rig can have are refused where they come in, and odd ones of real rigs are not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fpplab.calibration.interchange import import_calibration, to_opencv
from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Lattice
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import Pinhole, RigidTransform
from tests.calibration.examples import calibration

KNOWN = calibration()
POSE = KNOWN.T_projector_camera

# Published by users of other programs as the outcome of calibrations that had failed.
HOPELESS_PROJECTOR = Pinhole.from_focal(
    (912, 1140), (793.9, 999.9), (345, 84.6), (27.6, -2344.6, 7.97, 10.36, 0)
)
HOPELESS_CAMERA = Pinhole.from_focal((684, 456), (3039.1, 4814.0), (344.9, 231.3), (0.4458, -21.77, 0, 0, 0))


def camera(
    focal_px: tuple[float, float] = (3645.1, 3640.7),
    centre_px: tuple[float, float] = (683.5, 455.25),
    distortion: tuple[float, ...] = (),
) -> Calibration:
    return replace(KNOWN, camera=Pinhole.from_focal((1368, 912), focal_px, centre_px, distortion))


def moved(translation: tuple[float, float, float]) -> Calibration:
    return replace(KNOWN, T_projector_camera=RigidTransform(POSE.rotation, np.array(translation)))


IMPOSSIBLE = {
    "projector of a failed calibration": (
        replace(KNOWN, projector=HOPELESS_PROJECTOR),
        r"projector's distortion \(27\.6, -2345.*folds the image over: \d+ % .* more than 10 %",
    ),
    "camera of a failed calibration": (
        replace(KNOWN, camera=HOPELESS_CAMERA),
        r"camera's focal lengths fx 3039\.1 px and fy 4814 px .* 1\.58, .* must be 0\.741 to 1\.35",
    ),
    "barrel that folds": (camera(distortion=(-20.0, 0, 0, 0, 0)), "camera's distortion .* folds"),
    "pole of a rational lens": (camera(distortion=(0, 0, 0, 0, 0, -60.0, 0, 0)), "camera's distortion"),
    "more cushion than a lens has": (
        camera(distortion=(100.0, 0, 0, 0, 0)),
        "by a factor of .* more than 1.5",
    ),
    "square picture elements on a diamond": (
        replace(
            KNOWN, projector=Pinhole.from_focal((912, 1140), (1500, 1500), (455, 570), (), Lattice.DIAMOND)
        ),
        "on a diamond lattice: fy / fx is 1, but must be 1.48 to 2.7",
    ),
    "three times as high as wide": (
        replace(KNOWN, projector=Pinhole.from_focal((912, 1140), (1094, 3282), (455, 570))),
        "on a square lattice: fy / fx is 3",
    ),
    "centre far to the left": (
        camera(centre_px=(-3000, 455)),
        "principal point is -3000 px in x, far outside",
    ),
    "centre far below": (camera(centre_px=(683, 4000)), "principal point is 4000 px in y, far outside"),
    "baseline in m": (moved((-0.12, 0.003, 0.0125)), "stand 0.1207 mm apart, .* in another unit than mm"),
    "baseline in um": (moved((-9e4, 0, 0)), r"stand 9e\+04 mm apart"),
    "turned outwards": (
        replace(
            KNOWN,
            T_projector_camera=RigidTransform.from_vectors(np.array([0, -0.8, 0]), np.array([-200.0, 0, 0])),
        ),
        "do not look at the same space",
    ),
    "back to back": (
        replace(
            KNOWN,
            T_projector_camera=RigidTransform.from_vectors(np.array([0, np.pi, 0]), np.array([50.0, 0, 0])),
        ),
        "do not look at the same space.*from the camera's frame to the projector's",
    ),
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_what_no_rig_has_is_refused_from_files_of_both_kinds(name: str, tmp_path: Path) -> None:
    given, words = IMPOSSIBLE[name]
    given.save(tmp_path / "mine.yaml")
    with pytest.raises(ConfigError, match=rf"mine\.yaml: .*{words}"):
        Calibration.load(tmp_path / "mine.yaml")
    (tmp_path / "theirs.yml").write_text(to_opencv(given, "yaml"))
    with pytest.raises(ConfigError, match=rf"theirs\.yml: .*{words}"):
        import_calibration([tmp_path / "theirs.yml"])


@pytest.mark.parametrize(
    "given",
    [
        camera(centre_px=(-1200, 2000)),  # a region of interest in the corner of a sensor
        camera(focal_px=(1500, 1480), distortion=(-0.35, 0.15, 1e-3, -1e-3, -0.03)),  # a short lens
        camera(focal_px=(40_000, 40_200), distortion=(0.9, -400.0, 0, 0, 0)),  # nearly telecentric
        camera(focal_px=(700, 698), distortion=(0.5, 0.1, 4e-4, -3e-4, 0.01, 0.9, 0.3, 0.02)),  # a wide one
        camera(focal_px=(3645.1, 4860.0)),  # 4:3 shown as 16:9
        moved((0, -15.0, 0)),  # a microscope's
        moved((-6000, 0, 0)),  # a hall's
        replace(
            KNOWN, projector=Pinhole.from_focal((1280, 800), (1900, 1905), (640, 1000))
        ),  # with lens shift
    ],
)
def test_odd_rigs_are_none_the_less_loaded(given: Calibration, tmp_path: Path) -> None:
    given.save(tmp_path / "mine.yaml")
    assert Calibration.load(tmp_path / "mine.yaml").baseline_mm == pytest.approx(given.baseline_mm)
