"""Benches outside of the twin's model: their effects, and how they are judged."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.bent_response import decoded_error, response_figures
from benchmarks.hidden.worlds import drawn_world
from benchmarks.outside import (
    EFFECTS,
    S_SHAPE,
    JudgedEffect,
    Outside,
    _names,
    _same,
    effect_figures,
    groove,
    s_shaped,
)
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response
from sim.prediction import MeasuredFigures, Prediction
from sim.prediction.intervals import FigureInterval

SHOWN = np.linspace(0.0, 1.0, 256)


def test_response_has_the_form_of_an_s() -> None:
    curve = s_shaped(drawn_world(3, 1, 8)).projector.response
    np.testing.assert_allclose(curve.shape(SHOWN), SHOWN - S_SHAPE * np.sin(2 * np.pi * SHOWN), atol=2e-3)


def test_groove_is_a_closed_body_of_facing_walls(tmp_path: Path) -> None:
    body = trimesh.load(groove(tmp_path))
    assert isinstance(body, trimesh.Trimesh)
    assert body.is_watertight
    walls = body.face_normals[np.abs(body.face_normals[:, 0] * body.face_normals[:, 2]) > 0.1]
    assert {np.sign(one[0]) for one in walls} == {-1.0, 1.0}
    assert (walls[:, 2] < 0).all(), "towards the camera"


def answered(measured: float) -> JudgedEffect:
    interval = {name: FigureInterval(5.0, 4.0, 6.0) for name in MeasuredFigures(0, 0, 0, 0).summary()}
    said = Prediction("part", interval, 9, 100, 64, None)
    return JudgedEffect(
        "wax", "light below the surface", True, {"q": (said, MeasuredFigures(measured, 5, 5, 5))}
    )


def test_intervals_that_miss_are_counted() -> None:
    assert answered(5.5).missed == []
    assert answered(6.5).missed == ["q distance_um"]
    found = {one.name: one for one in effect_figures([answered(6.5)])}
    assert found["outside_wax_intervals_missed"].value == 1.0
    assert found["outside_wax_is_named"].value == 1.0


def test_an_effect_is_named_by_its_words() -> None:
    effect = Outside("wax", _same, _same, ("light below the surface",))
    assert _names(effect, "interreflection, light below the surface, or parts that moved")
    assert not _names(effect, "vibration")
    assert len({one.name for one in EFFECTS}) == 4


def test_a_bent_response_is_stated_and_corrected() -> None:
    true = s_shaped(drawn_world(3, 1, 8)).projector.response
    measured = Response(
        a=true.a, b=true.b, g=true.g, spline=true.spline, sigma=(0.001, 0.001, 0.001), residual=0.0, levels=16
    )
    found = {one.name: one.value for one in response_figures(measured, true)}
    assert max(found[f"bent_response_{n}_steps_stated_off"] for n in range(3, 13)) < 0.02
    assert min(found[f"bent_response_{n}_steps_corrected_unrounded"] for n in range(3, 13)) > 10
    straight = Plan(fringes=(Sinusoid(axis="x", stripes=7.3, steps=5),))
    assert decoded_error(straight, Curve(a=1.0, b=0.0, g=1.0)) == pytest.approx(0.0, abs=2e-3)
