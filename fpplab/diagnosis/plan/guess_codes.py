"""Guess what images of Gray code, white and black are: axes, bits, inverses and their order.

How wide cells are images do not show: the code is taken to reach over the whole projector from its edge.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from fpplab.core.conventions import Axis, Floats, Image, Mask, axis_length, full_scale
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.tagged_union import registered_types
from fpplab.diagnosis.plan.code_order import code_order_fault
from fpplab.diagnosis.plan.limits import GuessLimits
from fpplab.diagnosis.plan.other_patterns import BINARY, image_kinds, lit_by_projector
from fpplab.patterns.fringe_sets import PatternSet
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import check_codes, decode


@dataclass(frozen=True)
class CodeGuess:
    """A plan of codes that describes some images."""

    plan: Plan  # the plan
    misfit: float  # of the frames, in units of noise
    assumed: tuple[str, ...]  # what the images do not show, one sentence each


def guess_codes(
    frames: Sequence[Image], bits: int, projector_size: tuple[int, int], limits: GuessLimits
) -> CodeGuess | None:
    """Find a plan of codes; None where the images do not agree with one."""
    # frames (height, width); projector_size (width, height) px
    kinds = image_kinds(frames, full_scale(bits), limits)
    if kinds is None or kinds.count(BINARY) < limits.min_binary_images:
        return None
    kinds = [kind or BINARY for kind in kinds]  # blur leaves the finest bits no two levels
    try:
        plan = Plan(fringes=tuple(_sets(frames, kinds, projector_size, limits)))
        plan.check_projector(projector_size, "the plan guessed")
        check_codes(plan, projector_size, "the plan guessed")
    except (ConfigError, ValueError):
        return None
    step = max(1, int(np.sqrt(frames[0].size / limits.code_pixels)))
    sampled = [np.ascontiguousarray(frame[::step, ::step]) for frame in frames]
    recording = Recording(sampled, plan, projector_size, bits, "the images")
    if fault := code_order_fault(recording):
        raise DataError(f"the images look like Gray code, but {fault}")
    decoded, (_, lit) = decode(recording), _middle_and_lit(sampled, limits)
    if decoded.disagreement is None or decoded.valid[lit].mean() < limits.min_decoded_share:
        return None
    widths = ((each.coded_axis, each.model_dump().get("cell_px")) for each in plan.sets)
    cells = ", ".join(f"{cell_px:g} px along {axis}" for axis, cell_px in widths if cell_px)
    assumed = (
        "columns and rows are coded along the longer edges that the images show, in an upright camera",
        f"the code reaches over the whole projector from its edge, with cells of {cells}",
    )
    return CodeGuess(plan, float(np.nanmedian(decoded.disagreement)), assumed)


def _sets(
    frames: Sequence[Image], kinds: Sequence[str | None], size: tuple[int, int], limits: GuessLimits
) -> Iterator[PatternSet]:
    """Sets of the images in their order; `size` (width, height) px of the projector."""
    middle, lit = _middle_and_lit(frames, limits)
    bits = {k: frame > middle for k, frame in enumerate(frames)}
    registered: dict[str, Any] = registered_types(PatternSet)
    axes = _axes(kinds, {k: _axis_of(bits[k], lit) for k, kind in enumerate(kinds) if kind == BINARY})
    for axis, run in groupby(range(len(frames)), key=axes.get):
        images = list(run)
        edges = [sum(_edges(bits[k], lit)) for k in images]
        length = axis_length(size, axis or "x")
        for kind in registered.values():
            if fields := kind.guessed([bits[k][lit] for k in images], edges, axis, length):
                yield kind.model_validate({**fields, "projector_size": size})
                break


def _middle_and_lit(frames: Sequence[Image], limits: GuessLimits) -> tuple[Floats, Mask]:
    """Level of every pixel above which a bit is likelier set than not, and which pixels are lit."""
    black, white = (ends.reduce(list(frames)).astype(np.float64) for ends in (np.minimum, np.maximum))
    return 0.5 * (black + white), lit_by_projector(white - black, limits)


def _axes(kinds: Sequence[str | None], axes: dict[int, Axis]) -> dict[int, Axis]:
    """Axes of all images of codes, also of bits that are the same wherever the scene is."""
    # White beside black is a pair of references; other even images beside a code are bits of it.
    runs = [list(run) for _, run in groupby(range(len(kinds)), key=lambda k: kinds[k] == BINARY)]
    even = [run for run in runs if run[0] not in axes]
    has_pair = any(len({kinds[k] for k in run}) > 1 for run in even)
    joined = dict(axes)
    for run in even:
        kept = run[-2:] if run[-1] == len(kinds) - 1 else run[:2]
        is_pair = len({kinds[k] for k in kept}) > 1
        for k in run if has_pair and not is_pair else run[len(kept) :] if kept == run[:2] else run[:-2]:
            joined[k] = axes.get(run[-1] + 1) or axes[run[0] - 1]
    return joined


def _edges(image: Mask, lit: Mask) -> tuple[int, int]:
    """Changes between neighbouring lit pixels along the rows and along the columns."""
    right = (image[:, 1:] != image[:, :-1]) & lit[:, 1:] & lit[:, :-1]
    down = (image[1:] != image[:-1]) & lit[1:] & lit[:-1]
    return int(right.sum()), int(down.sum())


def _axis_of(image: Mask, lit: Mask) -> Axis:
    right, down = _edges(image, lit)
    return "x" if right > down else "y"
