"""The steps of a characterisation matching, each of which proposes parameters of the twin.

Order: geometry by the observed points, light, then one by one the effects that the paper names as missing
(ambient light, defocus of projector and camera, vignetting, the projector's falloff, a lamp of the room,
flicker, rolling bands, vibration, noise); then all parameters of light together and the geometry by the
images in turn; at last once more what changes from frame to frame. Falloff, lamp, flicker, bands and
vibration are kept where they explain more than their parameters cost. Noise is judged by its variance and
spectrum, since the images that the loss compares have none. Scans of parts with finer fringes than the
board's determine the projector's sharpness better than the board does, and alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from fpplab.core.config import Document
from fpplab.core.conventions import Floats
from sim.effects import EFFECTS, Effect
from sim.effects.step import FrameFluctuation, ReprojectionErrors, Ripple
from sim.matching.evaluation import characterise_twin, reprojection_errors
from sim.matching.fluctuation import bands, noise
from sim.matching.fluctuation.frame_series import fit_fluctuation
from sim.matching.fluctuation.frame_terms import GAIN, MOVES, ROOM, FrameTerms, terms_of_pose
from sim.matching.fluctuation.fringe_residuals import fringe_residuals
from sim.matching.geometry import geometry_fit
from sim.matching.light import light_fit, start_search
from sim.matching.light.contrast import ContrastSample, board_contrasts, with_common_error
from sim.matching.record import ParametersFile
from sim.matching.reference import Reference
from sim.matching.samples import PixelSample
from sim.parameters import TwinParameters
from sim.twin import Twin

SAMPLED_POSES = 6
"""Greatest number of poses whose pixels are compared by steps that fit light and noise (chosen)."""
MIN_CONTRAST, SIGNIFICANT = 0.02, 3.0
"""Relative difference of the contrast, and standard errors of it, by which the board must be sharper than
contrasts on parts say."""
PROJECTOR_FOCUS = ("projector_focus_mm", "projector_aperture_mm")
CAMERA_FOCUS = ("camera_focus_mm", "f_number")  # names of the parameters of focus and aperture
F_NUMBERS = (1.0, 2.0, 4.0)
APERTURES = (0.5, 1.0, 2.0)  # factors of the twin's own aperture with which the search for a focus starts


@dataclass(frozen=True, eq=False)
class MatchingContext:
    """What every step is given."""

    reference: Reference  # what was recorded of the bench
    twin: Twin  # with the parameters from which the step starts
    samples: list[PixelSample]  # pixels at which images are compared
    white: str  # the parameter that scales the levels
    contrasts: tuple[ContrastSample, ...] = ()  # of finer fringes on parts
    _terms: dict[str, list[FrameTerms]] = field(default_factory=dict)

    @property
    def parameters(self) -> TwinParameters:
        return self.twin.parameters

    def with_parameters(self, parameters: TwinParameters) -> MatchingContext:
        return replace(self, twin=self.twin.with_parameters(parameters))

    def frame_terms(self) -> list[FrameTerms]:
        """Estimate what every frame of some poses has beyond the twin's; kept while the light is the same."""
        steady = replace(self.parameters, sigma={})
        for effect in VARYING_EFFECTS:
            steady = effect.without(steady)
        key = ParametersFile.of(steady).model_dump_json()
        if key not in self._terms:
            self._terms.clear()
            poses = self.reference.spread_poses(SAMPLED_POSES)
            self._terms[key] = [terms_of_pose(self.reference, self.twin, pose) for pose in poses]
        return self._terms[key]

    def fluctuation(
        self, of: Literal["projector", "room", "position"], oscillates: bool = True
    ) -> FrameFluctuation:
        """Estimate how light, relative, or the item's position in mm changes from frame to frame."""
        columns = {"projector": GAIN, "room": ROOM, "position": MOVES}[of]
        return fit_fluctuation([terms.series(columns) for terms in self.frame_terms()], oscillates)

    def reprojection_errors(self) -> tuple[ReprojectionErrors, ReprojectionErrors]:
        """Compute the errors of the bench's characterisation, and of that of the twin's own frames."""
        own = characterise_twin(self.reference, self.twin, self.reference.spread_poses(SAMPLED_POSES))
        return reprojection_errors(self.reference.characterisation), reprojection_errors(own)

    def room_ripple(self) -> Ripple | None:
        """Find the ripple of the room's light; None where steady light explains the frames as well."""
        residuals = fringe_residuals(self.reference, self.parameters, _spread(self))
        return bands.strongest_ripple(self.frame_terms(), residuals)

    def light_parameters(self, *more: str) -> tuple[str, ...]:
        response = () if self.reference.response is not None else ("b", "g")
        return (self.white, "ink", "ambient", "black_level", *response, *more)

    @property
    def _max_black(self) -> float:
        """The greatest black level that the recordings allow, relative to full scale."""
        # The darkest places may have been rounded down by half a level.
        return (self.reference.darkest_level + 0.5) / self.reference.full_scale

    def fit(self, *names: str) -> TwinParameters:
        """Fit parameters of light and sharpness to the samples; the darkest places limit the black level."""
        # A print's edges are softer than the twin's; the camera's lens would be given their blur.
        also = None
        if not set(CAMERA_FOCUS).isdisjoint(names):
            also = light_fit.softness(self.reference, self.twin, self.samples)
        fitted = light_fit.fit_light(self.reference, self.twin, names, self.samples, also)
        if "black_level" not in names or fitted.black_level <= self._max_black:
            return fitted
        # Light that the parameters lack was taken for black: held, black leaves it to the ambient light, but
        # the bound of one parameter does not make the others better known.
        held = self.twin.with_parameters(replace(fitted, black_level=self._max_black))
        others = [name for name in names if name != "black_level"]
        refitted = light_fit.fit_light(self.reference, held, others, self.samples, also)
        return replace(refitted, sigma=fitted.sigma)

    def criterion(self, free: int) -> float:
        """Compute Schwarz's criterion of the samples, by the number of free parameters."""
        return light_fit.information_criterion(self.reference, self.twin, self.samples, free)

    def search_lamp(self, linear: Sequence[str]) -> TwinParameters:
        """Search for a lamp of the room from which to fit; linear: names of what is fitted with it."""
        return start_search.search_lamp(self.reference, self.twin, self.samples, linear)

    @property
    def projector_focus(self) -> tuple[str, ...]:
        """Names of the projector's focus and aperture, where its focus was searched."""
        return PROJECTOR_FOCUS if self.parameters.projector_focus_mm is not None else ()

    @property
    def camera_focus(self) -> tuple[str, ...]:
        """Names of the camera's focus and aperture, where its focus was searched."""
        return CAMERA_FOCUS if self.parameters.camera_focus_mm is not None else ()

    @property
    def blur_by_images(self) -> tuple[str, ...]:
        """The projector's blur, unless contrasts determine it."""
        return () if self.contrasts else ("projector_blur",)

    def fit_projector_sharpness(self) -> TwinParameters:
        """Fit blur, focus and aperture of the projector to contrasts, or else to the board's images."""
        # Together, what the twin lacks of the light on the board would decide: it is most of the residual.
        names = ("projector_blur", *self.projector_focus)
        if not self.contrasts:
            return light_fit.fit_light(self.reference, self.twin, names, self.samples)
        fitted = light_fit.fit_light(self.reference, self.twin, names, self.contrasts)
        return with_common_error(self.reference, self.twin.with_parameters(fitted), names, self.contrasts)


@dataclass(frozen=True)
class MatchingStep:
    """One step of a matching."""

    name: str  # as recorded and reported
    propose: Callable[[MatchingContext], TwinParameters]  # gives the parameters to try
    characterises: bool = False  # whether the twin's own RMS reprojection error must be found again
    misfit: Callable[[MatchingContext], float | Floats | None] = lambda at: None
    """What the step is judged by, as a whole or of each pose; None: the loss."""
    applies: Callable[[MatchingContext], bool] = lambda at: True  # whether the step is taken
    same_images: bool = False  # whether the images that the twin expects, which have no noise, stay the same
    explains: str = ""  # the effect that it finds, as reports describe it; none for what every twin has
    again: bool = True  # whether it is tried in a later round after it was refused


def _search_projector_defocus(context: MatchingContext) -> TwinParameters:
    if context.projector_focus:
        return context.fit_projector_sharpness()
    if context.contrasts:
        return _focus_by_contrasts(context)
    start = start_search.search_focus_grid(
        context.reference, context.twin, _ends(context.samples), *PROJECTOR_FOCUS, APERTURES
    )
    return context.with_parameters(start).fit_projector_sharpness()


def _focus_by_contrasts(context: MatchingContext) -> TwinParameters:
    """Fit the sharpness without a focus, and from several: contrasts are many times quicker than images."""
    start, candidates = context.parameters, []
    for focus in (None, *start_search.focus_distances(start, "projector_focus_mm")):
        tried = context.with_parameters(replace(start, projector_focus_mm=focus)).fit_projector_sharpness()
        refocused = context.twin.with_parameters(tried)
        candidates.append(
            (light_fit.mean_square_difference(context.reference, refocused, context.contrasts), tried)
        )
    return min(candidates, key=lambda candidate: candidate[0])[1]


def _fit_depth_of_field(context: MatchingContext) -> TwinParameters:
    if not context.camera_focus:
        start = start_search.search_focus_grid(
            context.reference, context.twin, _ends(context.samples), *CAMERA_FOCUS, F_NUMBERS
        )
        context = context.with_parameters(start)
    if not context.camera_focus:
        return context.parameters
    return context.fit(*context.blur_by_images, *CAMERA_FOCUS)


def _ends(samples: Sequence[PixelSample]) -> list[PixelSample]:
    """The nearest, the middle and the farthest pose."""
    return [samples[0], samples[len(samples) // 2], samples[-1]]


def _fit_light_and_focus_together(context: MatchingContext) -> TwinParameters:
    now = context.parameters
    names = [*context.blur_by_images, "vignetting"]
    for effect in EFFECTS:
        if effect.is_in(now):
            names += effect.fitted
    if not context.contrasts:
        names += context.projector_focus
    return context.fit(*context.light_parameters(*names, *context.camera_focus))


def _board_is_sharper(context: MatchingContext) -> bool:
    """Whether the board's fringes have more contrast than the twin's, in the mean over poses."""
    # Then it is not the projector that takes contrast from fringes on the parts, but the parts themselves.
    contrasts = board_contrasts(context.reference, context.twin, _spread(context))
    if not contrasts.size:
        return False
    off = contrasts.mean(axis=1)
    error = off.std(ddof=1) / np.sqrt(len(off)) if len(off) > 1 else 0.0
    return bool(off.mean() > max(MIN_CONTRAST, SIGNIFICANT * error))


def _fit_without_contrasts(context: MatchingContext) -> TwinParameters:
    """Search the projector's focus by the board's images, and fit all light again."""
    alone = replace(context, contrasts=()).with_parameters(
        replace(context.parameters, projector_focus_mm=None)
    )
    return _fit_light_and_focus_together(alone.with_parameters(_search_projector_defocus(alone)))


def _contrast_misfit_left(context: MatchingContext) -> float | None:
    """What is left of contrasts, of which the loss knows nothing; None without them."""
    if not context.contrasts:
        return None
    return light_fit.mean_square_difference(context.reference, context.twin, context.contrasts)


def _refine_by_images(at: MatchingContext) -> TwinParameters:
    return geometry_fit.refine_by_images(at.reference, at.twin, at.reference.characterisation.level)


def _spread(at: MatchingContext) -> tuple[int, ...]:
    return at.reference.spread_poses(SAMPLED_POSES)


def _noise_poses(at: MatchingContext) -> tuple[int, ...]:
    return at.reference.spread_poses(noise.LIMITS.poses)


def _steps_of(effects: Sequence[Effect[Document]]) -> tuple[MatchingStep, ...]:
    return tuple(
        MatchingStep(
            effect.name,
            effect.propose,
            characterises=effect.characterises,
            misfit=effect.misfit,
            same_images=effect.varies,
            explains=effect.explains,
        )
        for effect in effects
        if effect.is_matched
    )


VARYING_EFFECTS = tuple(effect for effect in EFFECTS if effect.varies)  # those that no expected image shows
SHARPNESS_OF_BOARD = MatchingStep(
    "sharpness of the board",
    _fit_without_contrasts,
    applies=lambda at: bool(at.contrasts) and _board_is_sharper(at),
)
"""Taken after all rounds, where contrasts gave a blur that the board's fringes do not have."""
CHANGING_STEPS = _steps_of(VARYING_EFFECTS)
"""What changes from frame to frame: found before noise is compared, and again with the light at the end,
but for errors of points."""
FIRST_STEPS = (
    MatchingStep(
        "points", lambda at: geometry_fit.refine_by_reprojection(at.parameters, at.reference.characterisation)
    ),
    MatchingStep("light", lambda at: at.fit(at.white, "ink", "projector_blur")),
    MatchingStep(
        "ambient light",
        lambda at: at.fit(*at.light_parameters()),
        explains="light that is not the projector's, and the camera's black level",
    ),
    MatchingStep(
        "projector defocus",
        _search_projector_defocus,
        misfit=_contrast_misfit_left,
        explains="blur of the projector that grows with the distance from its focus",
    ),
    MatchingStep(
        "depth of field",
        _fit_depth_of_field,
        explains="blur of the camera that grows with the distance from its focus",
    ),
    MatchingStep(
        "vignetting",
        lambda at: at.fit(at.white, "vignetting"),
        explains="light that the camera's lens loses towards the corners of the image",
    ),
    *_steps_of([effect for effect in EFFECTS if not effect.varies]),
    *CHANGING_STEPS,
    MatchingStep(
        "noise",
        lambda at: noise.match_noise(at.reference, at.twin, _noise_poses(at)),
        True,
        lambda at: noise.noise_misfit(at.reference, at.twin, _noise_poses(at)),
        same_images=True,
        explains="noise of the sensor",
    ),
)
EXPLAINS = {step.name: step.explains for step in FIRST_STEPS if step.explains}
"""The effects that are matched beyond the paper, by step."""
CHANGING = {step.name for step in FIRST_STEPS if step.same_images}
"""Those that differ from frame to frame: no expected image shows them."""
REPEATED_STEPS = (
    MatchingStep("together", _fit_light_and_focus_together),
    MatchingStep(
        "images",
        _refine_by_images,
        # Points allow for a picture that walks from pose to pose, a twin's images do not.
        applies=lambda at: at.reference.is_steady,
        again=False,  # what the twin lacks and images take for geometry is the same in every round
    ),
    MatchingStep(
        "fine fringes",
        lambda at: at.fit_projector_sharpness(),
        misfit=_contrast_misfit_left,
        applies=lambda at: bool(at.contrasts),
    ),
)
