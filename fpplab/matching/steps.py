"""The steps of a characterisation matching, each of which proposes parameters of the twin.

Order: geometry by the observed points, light, then one by one the effects that the paper names as missing
(ambient light, defocus of projector and camera, vignetting, the projector's falloff, a lamp of the room,
flicker, rolling bands, noise); at last all parameters of light together and the geometry by the images in
turn. Falloff, lamp, flicker and bands are kept where they explain more than their parameters cost. Noise is
judged by its variance and spectrum, since the images that the loss compares have none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from fpplab.matching import bands, flicker, geometry, light, noise, room_lamp
from fpplab.matching.frame_terms import FrameTerms, terms_of_pose
from fpplab.matching.fringe_rests import fringe_rests
from fpplab.matching.light import PixelSample
from fpplab.matching.record import ParametersFile
from fpplab.matching.reference import Reference
from fpplab.simulation.matchable import Twin, TwinParameters

SAMPLED_POSES = 6
"""Greatest number of poses whose pixels are compared by steps that fit light and noise."""
STEADY: dict[str, Any] = {
    "projector_flicker": 0.0,
    "ambient_ripple": 0.0,
    "band_period_px": 0.0,
    "band_advance": None,
    "sigma": {},
}
"""What parameters have in common whose expected images are alike."""
F_NUMBERS = (1.0, 2.0, 4.0)
APERTURES = (0.5, 1.0, 2.0)
"""Factors of the twin's own aperture with which the search for a focus starts."""


@dataclass(frozen=True, eq=False)
class MatchingContext:
    """What every step is given.

    Attributes
    ----------
    reference : Reference
        What was recorded of the bench.
    twin : Twin
        To be matched.
    samples : list of PixelSample
        Pixels at which images are compared.
    white : str
        The parameter that scales the levels: "white", or "paper" where a measured response fixes white.
    """

    reference: Reference
    twin: Twin
    samples: list[PixelSample]
    white: str
    _terms: dict[str, list[FrameTerms]] = field(default_factory=dict)

    def frame_terms(self) -> list[FrameTerms]:
        """Estimate what every frame of some poses has beyond the twin's; kept while the light is the same.

        Returns
        -------
        list of FrameTerms
            One for each of the poses.
        """
        now = self.twin.parameters
        still = replace(now, **STEADY)
        key = ParametersFile.of(still).model_dump_json()
        if key not in self._terms:
            self._terms.clear()
            poses = self.reference.spread_poses(SAMPLED_POSES)
            self._terms[key] = [terms_of_pose(self.reference, self.twin, pose) for pose in poses]
        return self._terms[key]

    def light_parameters(self, *more: str) -> tuple[str, ...]:
        """Name the parameters of light that are free.

        Parameters
        ----------
        *more : str
            Further names to be appended.

        Returns
        -------
        tuple of str
            Keys of `fpplab.matching.light.ADJUSTABLE`; the response is free only where it was not measured.
        """
        response = () if self.reference.response is not None else ("b", "g")
        black = () if self._black_is_held else ("black_level",)
        return (self.white, "ink", "ambient", *black, *response, *more)

    @property
    def _most_black(self) -> float:
        """The greatest black level that the recordings allow, relative to full scale.

        The darkest places may have been rounded down by half a level.
        """
        return (self.reference.darkest_level + 0.5) / self.reference.full_scale

    @property
    def _black_is_held(self) -> bool:
        return abs(self.twin.parameters.black_level - self._most_black) < 1e-9

    def fit(self, *names: str) -> TwinParameters:
        """Fit parameters of light and sharpness to the samples; the darkest places limit the black level.

        Parameters
        ----------
        *names : str
            Keys of `fpplab.matching.light.ADJUSTABLE`.

        Returns
        -------
        TwinParameters
            As `fpplab.matching.light.fit_light` finds them; the twin is left with them.
        """
        found = light.fit_light(self.reference, self.twin, names, self.samples)
        if "black_level" not in names or found.black_level <= self._most_black:
            return found
        # Light that the parameters lack was taken for black: held, black leaves it to the ambient light.
        self.twin.become(replace(found, black_level=self._most_black))
        others = [name for name in names if name != "black_level"]
        return light.fit_light(self.reference, self.twin, others, self.samples)


@dataclass(frozen=True)
class MatchingStep:
    """One step of a matching.

    Attributes
    ----------
    name : str
        As recorded and reported.
    propose : callable
        Gives the parameters to try, from the `MatchingContext` whose twin has the best ones so far.
    characterises : bool
        Whether the twin's own RMS reprojection error must be found again.
    misfit : callable or None
        What the step is judged by, less is better, in place of the loss.
    allowed : callable
        Whether what was proposed, which the twin has, may be accepted at all.
    """

    name: str
    propose: Callable[[MatchingContext], TwinParameters]
    characterises: bool = False
    misfit: Callable[[MatchingContext], float] | None = None
    allowed: Callable[[MatchingContext], bool] = lambda at: True


def _projector_defocus(at: MatchingContext) -> TwinParameters:
    names = ("projector_focus_mm", "projector_aperture_mm")
    if at.twin.parameters.projector_focus_mm is None:
        light.search_focus_grid(at.reference, at.twin, at.samples, *names, APERTURES)
    if at.twin.parameters.projector_focus_mm is None:
        return at.fit("projector_blur")
    return at.fit("projector_blur", *names)


def _depth_of_field(at: MatchingContext) -> TwinParameters:
    names = ("camera_focus_mm", "f_number")
    if at.twin.parameters.camera_focus_mm is None:
        light.search_focus_grid(at.reference, at.twin, at.samples, *names, F_NUMBERS)
    if at.twin.parameters.camera_focus_mm is None:
        return at.twin.parameters
    return at.fit("projector_blur", *names)


def _fit_together(at: MatchingContext) -> TwinParameters:
    now = at.twin.parameters
    names = ["projector_blur", "vignetting"]
    if any(now.projector_falloff):
        names += light.FALLOFF
    if now.lamp_irradiance:
        names += light.LAMP
    if now.projector_focus_mm is not None:
        names += ["projector_focus_mm", "projector_aperture_mm"]
    if now.camera_focus_mm is not None:
        names += ["camera_focus_mm", "f_number"]
    return at.fit(*at.light_parameters(*names))


def _evidence_for_falloff(at: MatchingContext) -> float:
    free = len(light.FALLOFF) if any(at.twin.parameters.projector_falloff) else 0
    return light.information_criterion(at.reference, at.twin, at.samples, free)


def _room_lamp(at: MatchingContext) -> TwinParameters:
    """Fit the light without and with a lamp, which is kept where it explains more than it costs."""
    without = at.fit(*at.light_parameters())
    least = _evidence_for_lamp(at)
    linear = [name for name in (at.white, "ambient", "black_level") if name in at.light_parameters()]
    found = room_lamp.search_lamp(at.reference, at.twin, at.samples, linear)
    if found.lamp_irradiance:
        found = at.fit(*at.light_parameters(*light.LAMP))
        if _evidence_for_lamp(at) < least:
            return found
    at.twin.become(without)
    return without


def _evidence_for_lamp(at: MatchingContext) -> float:
    free = len(light.LAMP) if at.twin.parameters.lamp_irradiance else 0
    return light.information_criterion(at.reference, at.twin, at.samples, free)


def _refine_by_images(at: MatchingContext) -> TwinParameters:
    return geometry.refine_by_images(at.reference, at.twin, at.reference.characterisation.level)


def _rolling_bands(at: MatchingContext) -> TwinParameters:
    now = at.twin.parameters
    return bands.match_bands(now, at.frame_terms(), fringe_rests(at.reference, now, _spread(at)))


def _spread(at: MatchingContext) -> tuple[int, ...]:
    return at.reference.spread_poses(SAMPLED_POSES)


FIRST_STEPS = (
    MatchingStep(
        "points",
        lambda at: geometry.refine_by_reprojection(at.twin.parameters, at.reference.characterisation),
    ),
    MatchingStep("light", lambda at: at.fit(at.white, "ink", "projector_blur")),
    MatchingStep("ambient light", lambda at: at.fit(*at.light_parameters())),
    MatchingStep("projector defocus", _projector_defocus),
    MatchingStep("depth of field", _depth_of_field),
    MatchingStep("vignetting", lambda at: at.fit(at.white, "vignetting")),
    MatchingStep(
        "projector falloff",
        lambda at: at.fit(at.white, "vignetting", *light.FALLOFF),
        misfit=_evidence_for_falloff,
    ),
    MatchingStep("room lamp", _room_lamp, misfit=_evidence_for_lamp),
    MatchingStep("flicker", lambda at: flicker.match_flicker(at.twin.parameters, at.frame_terms())),
    MatchingStep("rolling bands", _rolling_bands),
    MatchingStep(
        "noise",
        lambda at: noise.match_noise(at.reference, at.twin, _spread(at), at.frame_terms()),
        True,
        lambda at: noise.noise_misfit(at.reference, at.twin, _spread(at)),
    ),
)
REPEATED_STEPS = (
    MatchingStep("together", _fit_together),
    MatchingStep(
        "images",
        _refine_by_images,
        allowed=lambda at: geometry.contradiction(at.reference, at.twin.parameters) <= 1.0,
    ),
)
