"""How far a twin's figures were from its bench's where both are known: the width of every prediction.

For each figure that is a scale (distance, noise) the logarithm of bench over twin is kept, from poses and
scans that the light was not fitted to, as far as there are such; for shares the difference.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import t as student

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.files import write_text

LARGE_NOISE, LARGE_DISTANCE, LARGE_LEVELS, LARGE_CONTRAST = 0.2, 0.4, 0.1, 0.05
"""Mean logarithms of noise and distance, and relative differences of levels and contrast, from which on they
are large."""
DISCREPANCY = "discrepancy.yaml"  # name of the file, next to the rig file of a matched twin
USUAL_NOISE, USUAL_DISTANCE, USUAL_SHARE = 0.043, 0.07, 0.02
"""Standard deviations of a comparison of bench and twin: of 60 predictions on twelve hidden benches 98 % were
within 10 % in noise, 85 % in distance (docs/decisions/prediction.md); that of completeness is chosen."""
PRIOR_TWINS = 4  # as how many comparisons those count, of which twins have more or less (chosen)
COVERAGE = 1.96  # half width of an interval of 95 %, in standard deviations (of the normal distribution)


class Deviation(Document):
    """What bench and twin differed by, for one figure."""

    mean: float
    """Mean difference, bench less twin; of logarithms for a scale."""
    spread: float
    """Standard deviation of a single comparison about the mean; 0 where there is only one."""
    count: int
    """Number of comparisons."""
    fitted: bool
    """Whether the twin was fitted to the same recordings: the deviation is then too small."""

    @classmethod
    def of(cls, differences: Sequence[float], fitted: bool) -> Deviation:
        """Summarise comparisons of one kind."""
        return cls.of_kinds([differences], fitted)

    @classmethod
    def of_kinds(cls, kinds: Sequence[Sequence[float]], fitted: bool) -> Deviation:
        """Summarise comparisons of several kinds, each of which counts the same however many it has."""
        present = [np.asarray(values, np.float64) for values in kinds if len(values)]
        means, count = np.array([values.mean() for values in present]), sum(len(values) for values in present)
        within = sum(float(np.sum((values - values.mean()) ** 2)) for values in present) / max(
            count - len(present), 1
        )
        between = float(means.var(ddof=1)) if len(present) > 1 else 0.0
        spread = float(np.sqrt(within + between))
        return cls(mean=float(means.mean()), spread=spread, count=count, fitted=fitted)

    def sigma(self, usual: float) -> float:
        """Standard deviation with which the next comparison is expected about 0; `usual` is that of twins."""
        # The mean is not corrected for, since it is a fault of the twin which another plan need not share.
        # The variance about 0 has the conjugate prior, a scaled inverse χ² of `PRIOR_TWINS` degrees of
        # freedom, so that few poses or scans that agree by chance are not believed, and one that differs does
        # not count for all (Gelman et al., Bayesian Data Analysis, 3rd ed., 2.6). What is expected has
        # Student's distribution, whose 95 % are given as those of the normal one.
        freedom = PRIOR_TWINS + self.count
        squares = PRIOR_TWINS * usual**2 + self.count * (self.mean**2 + self.spread**2)
        return float(np.sqrt(squares / freedom) * student.ppf(0.975, freedom) / COVERAGE)


class ContrastDeviation(Document):
    """What the contrast of fringes of bench and twin differed by, at the finest that were compared."""

    stripes: float
    """Over the projector's image."""
    relative: float
    """RMS difference of the contrast's logarithm."""

    def sigma(self, stripes: float) -> float:
        """Relative standard uncertainty of the contrast, and so of the noise, of finer fringes."""
        # Blur of any kind lowers the contrast's logarithm by the square of the number of stripes, as long as
        # it is less than a fringe.
        ratio = (stripes / self.stripes) ** 2
        return self.relative * float(np.sqrt(ratio**2 - 1.0)) if ratio > 1.0 else 0.0


class LevelDifferences(Document):
    """RMS differences of the grey levels over the board, relative to the mean level of each pose."""

    by_pose: dict[str, float]
    """By name of the session."""
    by_pattern: dict[str, float]
    """By pattern; the first of every fringe set is compared."""
    by_place: tuple[tuple[float | None, ...], ...]
    """In tiles over the board as the camera sees it, row by row from its top; None where no pose has any."""
    left_out: tuple[str, ...] = ()
    """Poses whose images the light was not fitted to."""


@dataclass(frozen=True)
class ScanEffects:
    """What a scan of a part shows by itself."""

    item: str  # the part
    contrast: float  # by how much the contrast of fine fringes is greater than the twin's, relative
    um_per_frame: float | None  # speed of the part away from the camera in µm from frame to frame


class Discrepancy(Document):
    """What still differs between a matched twin and its bench, as its predictions need it."""

    noise: Deviation | None = None
    """Of the logarithm of the noise: of the coordinate on the board, and of the points of scans."""
    distance: Deviation | None = None
    """Of the logarithm of the distance between points and true surface; from scans."""
    completeness: Deviation | None = None
    """Of the share of lit pixels that became points; from scans."""
    contrast: ContrastDeviation | None = None
    """Of the finest fringes, on the board or on parts."""
    levels: LevelDifferences | None = None
    """Of the images of the board."""
    parts: tuple[str, ...] = ()
    """Items that were compared; a part of another material has a surface that nobody has looked at."""
    looks_like: str | None = None
    """What the difference looks like, where it is large."""
    not_for: str | None = None
    """For which measurements the twin must not be trusted."""

    def save(self, folder: Path) -> None:
        write_text(folder / DISCREPANCY, config.dump(self))

    @classmethod
    def beside(cls, rig: Path) -> Discrepancy | None:
        """Read the file next to a rig file."""
        path = rig.parent / DISCREPANCY
        return config.load_document(path, cls) if path.is_file() else None


def named_effects(
    discrepancy: Discrepancy,
    board_noise: Sequence[float],
    part_noise: Sequence[float],
    scans: Sequence[ScanEffects] = (),
) -> tuple[str | None, str | None]:
    """Name what a large discrepancy looks like, and what the twin must not be trusted for."""
    # Points that are further from the surface than the twin's, with the same noise, have an error that is no
    # noise: something reaches the camera on another way than the twin's light.
    pairs = [
        *_of_scans(scans),
        *_of_noise(board_noise),
        *_of_parts(discrepancy, part_noise),
        *_of_levels(discrepancy.levels),
    ]
    looks_like, not_for = (
        (list(dict.fromkeys(each)) for each in zip(*pairs, strict=True)) if pairs else ([], [])
    )
    return ("; ".join(looks_like) or None, "; ".join(not_for) or None)


def _of_scans(scans: Sequence[ScanEffects]) -> Iterator[tuple[str, str]]:
    for scan in scans:
        if scan.contrast < -LARGE_CONTRAST:
            less = f"{-100 * scan.contrast:.0f} % less contrast"
            yield (
                f"interreflection, or light below the surface of the {scan.item}: its fine fringes have "
                f"{less} than the projector's sharpness on the board allows",
                "parts of another material than the twin's",
            )
        if scan.um_per_frame is not None:
            yield (
                f"parts that moved: the {scan.item} by {scan.um_per_frame:+.1f} µm from frame to frame, away "
                "from the camera",
                "parts that do not stand still",
            )


def _of_noise(board_noise: Sequence[float]) -> Iterator[tuple[str, str]]:
    if abs(float(np.mean(board_noise))) > LARGE_NOISE:
        yield (
            "noise that the twin lacks: vibration, flicker, or light of the room on the mains",
            "noise and chance of wrong orders",
        )


def _of_parts(discrepancy: Discrepancy, part_noise: Sequence[float]) -> Iterator[tuple[str, str]]:
    apart = discrepancy.distance is not None and discrepancy.distance.mean > LARGE_DISTANCE
    noisier = abs(float(np.mean(part_noise))) if part_noise else 0.0
    if apart and part_noise and noisier < LARGE_NOISE:
        yield (
            "interreflection, light below the surface, parts that moved, or an unknown response",
            "distances from surfaces of other shapes and materials",
        )
    elif apart or noisier > LARGE_NOISE:
        yield (
            "a part of another reflectance or gloss than in the twin's world (match --surface)",
            "parts of this surface",
        )


def _of_levels(levels: LevelDifferences | None) -> Iterator[tuple[str, str]]:
    if levels is not None and max(levels.by_pose.values()) > LARGE_LEVELS:
        yield (
            "uneven light or reflectance: falloff, gloss, a second lamp, or print",
            "levels and saturation",
        )
