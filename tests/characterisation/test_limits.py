"""Limits of a characterisation are one value, which a file may change."""

from functools import partial
from pathlib import Path

import pytest

from fpplab.characterisation import DistortionModel, characterise
from fpplab.characterisation.limits import CharacterisationLimits
from fpplab.core.config import field_descriptions, load_document
from fpplab.core.errors import CalibrationError, ConfigError
from tests.characterisation.test_judging import seen
from tests.support.rigs import BOARD, CAMERA, SQUARE


def test_limits_of_a_file_are_used_and_said(tmp_path: Path) -> None:
    path, poses = tmp_path / "limits.yaml", seen(4, 3)
    path.write_text("max_focal_uncertainty: 0.05\n")
    limits = load_document(path, CharacterisationLimits)
    given = poses, BOARD, CAMERA.size, SQUARE.size
    fit = partial(characterise, *given, level=DistortionModel.K3, validate=False)
    result = fit(limits=limits)
    assert result.summary()["limits"] == {"max_focal_uncertainty": 0.05}
    strict = CharacterisationLimits(max_focal_uncertainty=1e-7)
    with pytest.raises(CalibrationError, match="the camera's focal length is"):
        fit(limits=strict)
    assert "limits" not in fit().summary()


def test_a_limit_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text("max_focal: 0.05\n")
    with pytest.raises(ConfigError, match="unknown key 'max_focal'"):
        load_document(path, CharacterisationLimits)


def test_every_limit_says_where_it_comes_from() -> None:
    descriptions = field_descriptions(CharacterisationLimits)
    for name in CharacterisationLimits.model_fields:
        assert any(one in descriptions.get(name, "") for one in ("Derived", "Measured", "Chosen")), name
