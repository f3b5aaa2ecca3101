"""A part of the image is blurred by something on a lens."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
import scipy

from fpplab.core.config import Positive
from fpplab.core.conventions import TWO_PI, Floats, Mask, axis_length
from fpplab.core.robust import robust_spread
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.limits import CountLimit, LimitsSection, ShareLimit
from fpplab.diagnosis.pictures import draw_sample_map


class LensSmearLimits(LimitsSection):
    """How much a part of the image may be blurred more than the rest."""

    max_blur_px: Positive = 1.0
    """Blur in camera px, in squares beyond that of other pixels at such a depth. Chosen: a drop that blurs by
    a pixel bends rays by as much."""
    min_sigmas: Positive = 6.0
    """The same as a multiple of what the squares scatter by over the image. Chosen: no healthy part of it."""
    max_loss_by_other: Positive = 4.0
    """Contrast that wider fringes lose there, as a multiple of what blur that takes the finest's would take.
    Measured: drops reach 2; light by way of other surfaces takes 10 times as much."""
    min_share: ShareLimit = 0.01
    """Share of the measured pixels that lie in such a part. Chosen."""
    min_pixels: CountLimit = 500
    """Measured pixels of the sample that blur is compared between. Chosen."""


def blur_beyond_depth(evidence: Evidence) -> Floats | None:
    """Square of the blur in px² at the sample's pixels, less what depth and place in the image explain."""
    if evidence.recording is None or _set_with_little_blur(evidence) is None:
        return None  # blur cannot be separated from light by way of other surfaces
    sample, limits = evidence.frames, evidence.limits.of(LensSmearLimits)
    plan, step, cloud = sample.recording.plan, sample.step, evidence.cloud
    axis = plan.axes[0]
    finest, coordinate = plan.finest_set(axis), sample.coordinates.get(axis)
    if coordinate is None or cloud is None or cloud.pixels is None:
        return None
    turn = TWO_PI * plan.fringes[finest].stripes / axis_length(sample.recording.projector_size, axis)
    numbers = sample.numbers_of(cloud.pixels)
    z = np.where(numbers < 0, np.nan, cloud.points[numbers, 2].astype(np.float64))
    # Across a whole step, since noise of neighbouring pixels would seem to be slope.
    slope = np.square(np.gradient(coordinate[::step, ::step].astype(np.float64), step)).sum(axis=0)
    share = sample.fits[finest].modulation / np.maximum(sample.widest.modulation, 1e-3)
    used = sample.measured & np.isfinite(z) & (slope > 0.0)
    if used.sum() < limits.min_pixels:
        return None
    square = -2.0 * np.log(np.maximum(share[used], 1e-3)) / turn**2
    v, u = (part[used] / max(part.max(), 1) - 0.5 for part in np.indices(z.shape))
    d = (z[used] - z[used].mean()) / max(float(z[used].std()), 1e-9)
    # The projector's blur is the same in its own px wherever a surface faces, the camera's is not.
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v, d, d * d, slope[used]])
    kept = np.full(len(d), True)
    for _ in range(4):
        counted = terms * kept
        strengths = np.linalg.lstsq(counted @ terms.T, counted @ square, rcond=None)[0]
        rest = square - strengths @ terms
        kept = np.abs(rest) <= 4.5 * np.median(np.abs(rest))
    result = np.zeros(z.shape, np.float32)
    result[used] = rest / slope[used]
    return np.asarray(cv2.medianBlur(result, 5), np.float64)


def _set_with_little_blur(evidence: Evidence) -> int | None:
    """Number of the finest set of the first axis that blur weakens little; never that of the widest."""
    fringes, axis = evidence.plan.fringes, evidence.plan.axes[0]
    own = sorted((fringe.stripes, k) for k, fringe in enumerate(fringes) if fringe.axis == axis)
    return next((k for stripes, k in own[:0:-1] if stripes <= 0.25 * own[-1][0]), None)


def _find(evidence: Evidence, before: Sequence[Finding]) -> Iterator[Finding]:
    if any(finding.cause.key in ("camera_focus", "projector_focus", "interreflection") for finding in before):
        return  # they take contrast from fine fringes too, and from place to place
    beyond, limits = blur_beyond_depth(evidence), evidence.limits.of(LensSmearLimits)
    if beyond is None:
        return
    sample = evidence.frames
    scatter = robust_spread(beyond[sample.measured], 0.0)
    parts, count = scipy.ndimage.label(beyond > max(limits.max_blur_px**2, limits.min_sigmas * scatter))
    if not count:
        return
    sizes = np.bincount(parts.ravel())[1:]
    inside = parts == 1 + int(np.argmax(sizes))
    share = float(sizes.max()) / max(int(sample.measured.sum()), 1)
    if share < limits.min_share or not _is_loss_by_blur(evidence, inside & sample.measured):
        return
    blur = float(np.sqrt(np.median(beyond[inside])))
    v, u = (sample.step * float(np.mean(part)) for part in np.nonzero(inside))
    x = "xy".index(sample.recording.plan.axes[0])
    points = evidence.points
    um = 1e3 * blur * float(points.projector_px_per_px[x] / points.px_per_mm_of_depth[x])
    text = (
        f"around column {u:.0f}, row {v:.0f}, {100 * share:.1f} % of the pixels are blurred by {blur:.1f} px "
        f"more than others at their depth (at most {limits.max_blur_px:g}); what blurs bends rays too, and "
        f"points may be {um:.0f} µm off there, which their uncertainty does not contain"
    )
    yield Finding(LENS_SMEAR, text, blur / limits.max_blur_px)


def _is_loss_by_blur(evidence: Evidence, inside: Mask) -> bool:
    """Whether wider fringes lose little contrast there, as blur of few px has it, and stray light not."""
    sample, plan, wider = evidence.frames, evidence.plan, _set_with_little_blur(evidence)
    assert wider is not None
    finest = plan.finest_set(plan.axes[0])
    widest = sample.widest.modulation
    others = sample.measured & ~inside
    of_finest, of_wider = (
        np.log(np.median(share[others]) / max(float(np.median(share[inside])), 1e-3))
        for share in (sample.fits[k].modulation / np.maximum(widest, 1e-3) for k in (finest, wider))
    )
    by_blur = (plan.fringes[wider].stripes / plan.fringes[finest].stripes) ** 2 * of_finest
    return bool(of_wider <= evidence.limits.of(LensSmearLimits).max_loss_by_other * by_blur)


def _draw(evidence: Evidence, _: Finding) -> Figure | None:
    beyond = blur_beyond_depth(evidence)
    if beyond is None:
        return None
    limit = evidence.limits.of(LensSmearLimits).max_blur_px
    blur = np.sqrt(np.maximum(beyond, 0.0))
    return draw_sample_map(blur, evidence.frames, "viridis", (0.0, 3.0 * limit), "blur beyond others, px")


LENS_SMEAR = FaultCause(
    key="lens_smear",
    meaning="Part of the image is blurred, as by a drop or grease on a lens.",
    remedy="clean the lenses of camera and projector where the picture shows the blur, and scan again",
    measured="blur of each pixel from the contrast of the finest fringes relative to the widest, minus "
    "the part explained by depth and image position; the next wider fringes must confirm it",
    limit=f"{LensSmearLimits().max_blur_px:g} px in {100 * LensSmearLimits().min_share:g} % of the pixels",
    seen_in="points",
    detectors=(Detector(DetectionStage.POINTS, _find),),
    picture=Picture(Needs.POINTS, _draw),
    side_effects=frozenset({"stale_calibration", "wrong_resolution"}),
)
