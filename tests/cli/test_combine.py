"""`fpplab characterise --combine`: several calibrations of one rig."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fpplab.calibration.model import Calibration
from fpplab.characterisation import DistortionModel, characterise, judge
from fpplab.core.geometry import RigidTransform
from tests.characterisation.test_correction import TRUE, seen_by
from tests.support.commands import Command
from tests.support.rigs import BOARD, CAMERA, SQUARE


def test_calibrations_of_one_rig_are_combined(fpplab: Command, tmp_path: Path) -> None:
    first, second, new = (tmp_path / f"{name}.yaml" for name in ("first", "second", "new"))
    shift = RigidTransform.from_vectors(np.zeros(3), np.array([0.5, 0.0, 0.0]))
    rigs = TRUE, replace(TRUE, T_projector_camera=shift @ TRUE.T_projector_camera)
    for seed, (rig, file) in enumerate(zip(rigs, (first, second), strict=True)):
        poses = seen_by(rig, 6, seed)
        characterise(poses, BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K3).calibration.save(file)
    done = fpplab("characterise", "--combine", first, second, "--out", new, "--json")
    assert done.code == 0, done.err
    assert "T_projector_camera.x" in done.json["varying"]
    assert done.json["combined"] == [str(first), str(second)]
    combined = Calibration.load(new)
    middle = TRUE.T_projector_camera.translation + 0.5 * shift.translation
    assert combined.T_projector_camera.translation == pytest.approx(middle, abs=0.2)
    assert not any(judge(combined, seen_by(rig, 2, 9)).contradicted for rig in rigs)
    table = fpplab("characterise", "--combine", first, second, "--out", new, "--force")
    assert "varies" in table.out
    for words, said in (
        (["--combine", first, second], "--combine needs --out"),
        (["--combine", first, "--out", tmp_path / "x.yaml"], "needs two calibrations or more"),
        (["--combine", first, second, "--out", new], "exists already"),
        (["--combine", first, "--judge", first, "--out", new], "which takes calibrations"),
    ):
        refused = fpplab("characterise", *words, "--json")
        assert (refused.code, said in refused.json["error"]) == (2, True), refused.json
