"""Validation of a pattern sequence by the controller. Which cause sets which bit is in part an assumption."""

from collections.abc import Sequence
from itertools import pairwise

from drivers.dlp4500.layout import Values
from drivers.dlp4500.protocol import PatternTrigger
from drivers.dlp4500.sequence import MIN_EXPOSURE_US, bit_planes

MIN_GAP_US = 230
"""Shortest dark time in µs between an exposure and the next pattern, unless it is none at all (TI's GUI)."""


def validate_sequence(
    entries: Sequence[Values],
    times_us: Sequence[tuple[int, int]],
    images: Sequence[int],
    counts: tuple[int, int],
    flash_images: int | None,
    vsync_us: float | None,
    accepts_gap: bool,
) -> Values:
    # times_us (int, int) µs; counts (int, int)
    return {
        "exposure_invalid": int(
            any(exposure > period for exposure, period in times_us)
            or _too_short(entries, times_us)
            or (vsync_us is not None and _beyond_frame(entries, times_us, vsync_us))
        ),
        "pattern_invalid": int(
            len(entries) < counts[0]
            or any(not _exists(entry) for entry in entries)
            or (flash_images is not None and not _images_fit(entries, images, counts[1], flash_images))
        ),
        "trigger_overlap": int(any(a["black_after"] and b["share_trigger"] for a, b in pairwise(entries))),
        "black_missing": int(
            any(
                b["trigger"] in (PatternTrigger.RISING, PatternTrigger.FALLING) and not a["black_after"]
                for a, b in pairwise(entries)
            )
        ),
        "gap_too_short": int(
            any(_gap_too_short(period - exposure, accepts_gap) for exposure, period in times_us)
        ),
    }


def _gap_too_short(gap_us: int, accepts_gap: bool) -> bool:
    return 0 < gap_us < MIN_GAP_US or (gap_us == MIN_GAP_US and not accepts_gap)


def _exists(entry: Values) -> bool:
    try:
        bit_planes(entry["depth"], entry["pattern"])
    except ValueError:
        return False
    return True


def _images_fit(entries: Sequence[Values], images: Sequence[int], declared: int, flash_images: int) -> bool:
    swaps = sum(bool(entry["swap"]) or i == 0 for i, entry in enumerate(entries))
    return len(images) >= declared == swaps and all(image < flash_images for image in images)


def _group_entries(entries: Sequence[Values], field: str) -> list[range]:
    """Group entries in runs in which all but the first have `field` set."""
    starts = [i for i, entry in enumerate(entries) if not (entry[field] and i)]
    return [range(a, b) for a, b in zip(starts, [*starts[1:], len(entries)], strict=True)]


def _too_short(entries: Sequence[Values], times_us: Sequence[tuple[int, int]]) -> bool:
    return any(
        times_us[group[0]][0] < len(group) * max(MIN_EXPOSURE_US.get(entries[i]["depth"], 0) for i in group)
        for group in _group_entries(entries, "share_trigger")
        if len(group)
    )


def _beyond_frame(entries: Sequence[Values], times_us: Sequence[tuple[int, int]], vsync_us: float) -> bool:
    starts = [i for i, entry in enumerate(entries) if entry["trigger"] != PatternTrigger.NONE or i == 0]
    frames = zip(starts, [*starts[1:], len(entries)], strict=True)
    return any(sum(exposure for exposure, _ in times_us[a:b]) > vsync_us for a, b in frames)
