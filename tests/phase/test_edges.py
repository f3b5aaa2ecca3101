"""Coordinates beside edges of reflectivity: corrected where the frames tell the blur, and in σ otherwise."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from fpplab.core.conventions import Floats, Mask
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode

PLAN = Plan(fringes=tuple(Sinusoid(axis="x", stripes=s, steps=4) for s in (1, 6, 24)))
FINE, PROJECTOR = 3, (912, 1140)


def printed(side: int, tail: float = 0.15) -> tuple[Recording, Floats, Floats]:
    """Squares on a bent surface, their true coordinates, and pixels from the nearest edge, inked ones < 0."""
    v, u = (np.indices((FINE * side,) * 2) + 0.5) / FINE - 0.5
    true = 60.0 + 1.2 * u + 0.2 * v + 2e-4 * (u - 0.4 * side) ** 2
    ink = (np.floor((u + 0.13 * v) / 37.0) + np.floor((v - 0.13 * u) / 37.0)) % 2
    dark = ink[1::FINE, 1::FINE] > 0
    apart = np.where(dark, -distance_transform_edt(dark), distance_transform_edt(~dark))
    return captured(true, 1.0 - 0.8 * ink, tail), true[1::FINE, 1::FINE], apart


def captured(true: Floats, brightness: Floats, tail: float) -> Recording:
    """Blurred and noisy frames of a surface, given at `FINE` places along each side of a pixel."""
    side = len(true) // FINE
    random, frames = np.random.default_rng(side), []
    for k, step, _ in PLAN.steps():
        phase = 2 * np.pi * (PLAN.fringes[k].stripes * (true + 0.5) / 912 - step / 4)
        light = (brightness * (0.5 + 0.45 * np.cos(phase))).astype(np.float32)
        near, wide = (cv2.GaussianBlur(light, (0, 0), FINE * s) for s in (0.5, 4.5))
        seen = cv2.resize((1 - tail) * near + tail * wide, (side, side), interpolation=cv2.INTER_AREA)
        level = 6.0 + 200.0 * seen
        noisy = level + random.normal(0, 1, level.shape) * np.sqrt(0.3 + 0.03 * level)
        frames.append(np.rint(noisy).clip(0, 255).astype(np.uint8))
    return Recording(frames, PLAN, PROJECTOR)


def towards_the_bright(error: Floats, apart: Floats, used: Mask) -> float:
    """Root mean square over distances of the mean error towards the brighter side."""
    sign = np.sign(np.gradient(cv2.GaussianBlur(apart, (0, 0), 1.5), axis=1))
    across = used & (np.abs(np.gradient(cv2.GaussianBlur(apart, (0, 0), 2.5), axis=1)) > 0.4)
    means = [np.mean((sign * error)[across & (apart == d)]) for d in (-3, -2, -1, 1, 2, 3)]
    return float(np.sqrt(np.mean(np.square(means))))


@pytest.mark.parametrize("tail", [0.0, 0.15])
def test_a_blurred_edge_is_corrected_and_the_rest_is_in_sigma(
    monkeypatch: pytest.MonkeyPatch, tail: float
) -> None:
    recording, true, apart = printed(480, tail)
    decoded = decode(recording)
    monkeypatch.setattr("fpplab.phase.decoding.correct_edges", lambda *_: None)
    before = decode(recording)
    errors = [maps.u - true for maps in (decoded, before)]
    corrected, biased = (towards_the_bright(e, apart, decoded.valid & before.valid) for e in errors)
    assert corrected < 0.25 * biased
    far = (np.abs(apart) > 12) & decoded.valid & before.valid
    assert np.std(errors[0][far]) < 1.02 * np.std(errors[1][far])
    near = (np.abs(apart) < 4) & decoded.valid
    assert (np.abs(errors[0]) < 1.96 * decoded.sigma_total)[near].mean() == pytest.approx(0.95, abs=0.03)
    assert decoded.edges is not None
    assert decoded.edges.is_corrected
    assert 0.05 < decoded.edges.share < 0.9


def test_dots_too_dark_to_be_measured_hide_no_blur() -> None:
    v, u = (np.indices((FINE * 480,) * 2) + 0.5) / FINE - 0.5
    true = 20.0 + 1.8 * u + 0.2 * v + 2e-4 * (u - 190.0) ** 2
    dots = np.hypot((u + 0.13 * v) % 40 - 20, (v - 0.13 * u) % 40 - 20) < 9
    decoded = decode(captured(true, 1.0 - 0.995 * dots, 0.15))
    assert not decoded.valid.all()
    assert decoded.edges is not None
    assert decoded.edges.is_corrected


def test_borders_between_surfaces_do_not_change_the_blur() -> None:
    v, u = (np.indices((FINE * 640,) * 2) + 0.5) / FINE - 0.5
    true, beyond = 20.0 + 1.2 * u + 0.1 * v, np.hypot(u - 320, v - 320) - 190
    ink = (np.floor((u + 0.13 * v) / 37.0) + np.floor((v - 0.13 * u) / 37.0)) % 2
    alone = decode(captured(true, 1.0 - 0.8 * ink, 0.15)).edges
    behind, brightness = true + 0.1 * beyond - 2.0, np.where(beyond > 0, 0.12, 1.0 - 0.8 * ink)
    beside = decode(captured(np.where(beyond > 0, behind, true), brightness, 0.15)).edges
    assert alone is not None
    assert beside is not None
    np.testing.assert_allclose(beside.strengths, alone.strengths, rtol=0.15)


def test_an_image_too_small_to_tell_its_blur_has_the_error_in_sigma() -> None:
    recording, true, apart = printed(300, tail=0.0)
    decoded = decode(recording)
    assert decoded.edges is not None
    assert not decoded.edges.is_corrected
    assert decoded.edges.rms_px > 0
    near = (np.abs(apart) < 2) & decoded.valid
    assert (np.abs(decoded.u - true) < 1.96 * decoded.sigma_total)[near].mean() > 0.92


def test_an_even_surface_is_left_alone() -> None:
    columns, frames = np.arange(330), []
    for k, step, _ in PLAN.steps():
        phase = 2 * np.pi * (PLAN.fringes[k].stripes * columns / 912 - step / 4)
        level = np.rint(100 + 80 * np.cos(phase)).astype(np.uint8)
        frames.append(np.ascontiguousarray(np.broadcast_to(level, (330, 330))))
    assert decode(Recording(frames, PLAN, PROJECTOR)).edges is None


def test_facets_that_are_lit_unequally_tell_no_blur() -> None:
    """Where both the slope of the coordinate and the light change, as on pyramids side by side."""
    v, u = ((np.indices((FINE * 480,) * 2) + 0.5) / FINE - 0.5) / 60.0
    heights = np.random.default_rng(5).uniform(0.1, 0.4, (8, 8))[
        np.floor(v).astype(int), np.floor(u).astype(int)
    ]
    y, x = v % 1.0 - 0.5, u % 1.0 - 0.5
    across = np.abs(x) >= np.abs(y)
    slope_u, slope_v = -heights * np.sign(x) * across, -heights * np.sign(y) * ~across
    true = 60.0 + 72.0 * u + 12.0 * v - 30.0 * heights * np.maximum(np.abs(x), np.abs(y))
    shade = (0.8 - 0.5 * slope_u - 0.3 * slope_v) / np.sqrt(1.0 + slope_u**2 + slope_v**2)
    edges = decode(captured(true, np.clip(shade / 1.3, 0.05, 1.0), tail=0.0)).edges
    assert edges is not None
    assert not edges.is_corrected
