"""Every third image is dark: one colour of the images that carry three patterns."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Positive
from fpplab.core.conventions import Floats
from fpplab.diagnosis.brightness import BrightnessLimits, frame_levels
from fpplab.diagnosis.causes.flicker import FLICKER
from fpplab.diagnosis.evidence import Evidence
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Finding
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits, LimitsSection, ShareLimit
from fpplab.diagnosis.sample import FrameSample

COLOURS = 3  # patterns of 8 bits that one image of 24 bits carries


class MissingColourLimits(LimitsSection):
    """How much darker every third frame may be."""

    min_brightness: ShareLimit = 0.9
    """Brightness of the frames of one colour, as a share of the others'. Measured on benches."""
    min_scatters: Positive = 4.0
    """Difference as a multiple of the scatter of all frames' brightness. Measured on benches."""


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    if (finding := missing_colour(evidence.frames)) is not None:
        yield finding


def missing_colour(sample: FrameSample) -> Finding | None:
    """Look for a colour that is missing or weak: every third frame is darker than the others."""
    plan, limits = sample.recording.plan, sample.limits.of(BrightnessLimits)
    starts = zip(pairwise(plan.set_starts), plan.fringes, strict=True)
    frames = [(fringe.stripes, k) for (a, b), fringe in starts for k in range(a, b)]
    fine = [k for stripes, k in frames if stripes >= limits.min_stripes]
    finest = [k for stripes, k in frames if stripes >= limits.min_stripes_in_part]
    # Of 8 stripes the camera may see 3, so that the mean of a frame still depends on their phase a little.
    fine = finest if len(finest) >= 3 * COLOURS else fine
    if len(fine) < COLOURS:
        return None
    levels = frame_levels(sample)
    # Fringes of one set may have more contrast than those of another; half the frames have all colours.
    for a, b in pairwise(plan.set_starts):
        levels[a:b] /= max(float(np.sort(levels[a:b])[(b - a) // 2 :].mean()), 1.0)
    return colour_finding(levels[fine], np.array(fine), sample.limits)


def colour_finding(
    levels: Floats, places: NDArray[np.intp], limits: DiagnosisLimits = USUAL_LIMITS
) -> Finding | None:
    """Tell whether every third of some frames is darker than the others."""
    # levels (K,); places (K,)
    own, limit = [levels[places % COLOURS == c] for c in range(COLOURS)], limits.of(MissingColourLimits)
    if any(len(part) == 0 for part in own):
        return None
    worst = int(np.argmin([part.mean() for part in own]))
    others = np.concatenate([part for c, part in enumerate(own) if c != worst])
    share = float(own[worst].mean() / others.mean())
    scatter = math.hypot(float(others.std()), float(own[worst].std())) / float(others.mean())
    overlap = own[worst].max() >= others.min()
    if share >= limit.min_brightness or overlap or 1.0 - share < limit.min_scatters * scatter:
        return None
    text = (
        f"frames {worst + 1}, {worst + 4}, {worst + 7} … have {100 * share:.0f} % of the others' brightness "
        f"(at least {100 * limit.min_brightness:g} %): one of three colours is weak or missing"
    )
    # Weighed by what is lost, a missing colour ranks before everything that it brings about.
    excess = limit.min_brightness / max(share, 1e-3) * (1.0 - share) * 100.0
    return Finding(MISSING_COLOUR, text, excess)


MISSING_COLOUR = FaultCause(
    key="missing_colour",
    meaning="Every third image is dark: one colour channel of images with three patterns is missing.",
    remedy="check the LED, the cable and the colour channel of every third image; send images of 24 bits",
    measured="brightness of every third frame relative to the others",
    limit=f"{100 * MissingColourLimits().min_brightness:g} %, and "
    f"{MissingColourLimits().min_scatters:g} times their scatter",
    seen_in="frames, check",
    detectors=(Detector(DetectionStage.COLOUR, _find),),
    picture=FLICKER.picture,
    side_effects=frozenset({"stale_calibration"}),
    invalidates=frozenset({DetectionStage.FRAMES, DetectionStage.PLAN}),
    useless_from=30.0,  # three quarters of the others' brightness
)
