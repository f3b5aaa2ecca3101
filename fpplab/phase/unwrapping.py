"""Temporal unwrapping: the synthetic wavelengths of a plan, from coarse to fine.

Which wavelengths there are is said by the plan's method (`fpplab.patterns.unwrapping`). The position found on
one says which period of the next finer one is meant; the last is the finest set itself.

The base wraps at the projector's edges, where its noise would shift whole fringes. So there are two
hypotheses: the base as measured, and one turn off. The one that ends inside the projector wins; where both
do, the one that agrees better with the finer wavelengths.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

from fpplab.core.conventions import Axis
from fpplab.core.errors import ConfigError
from fpplab.patterns.plan import Plan
from fpplab.patterns.unwrapping import NEGLIGIBLE, SyntheticWavelength, unwrapping_methods


@dataclass(frozen=True)
class WavelengthSequence:
    """How one axis is unwrapped."""

    axis: Axis  # x or y
    sets: tuple[int, ...]  # indices into `Plan.fringes` of the axis' sets, fewest stripes first
    wavelengths: tuple[SyntheticWavelength, ...]  # from coarse to fine
    trust: tuple[float, ...]
    width: float  # greatest width of the interval of possible positions of a pixel

    @property
    def finest(self) -> int:
        """Index into `Plan.fringes` of the set that gives the coordinate."""
        return self.sets[-1]


def wavelength_sequence(
    plan: Plan, axis: Axis, source: str, interval_share: float | None = None, unwrapping: str | None = None
) -> WavelengthSequence:
    # `unwrapping` replaces the plan's method, where codes of other kinds tell the interval.
    sets, method = plan.sets_along(axis), unwrapping_methods()[unwrapping or plan.unwrapping]
    units = [
        SyntheticWavelength(tuple(int(i == k) for i in range(len(sets))), plan.fringes[index].stripes)
        for k, index in enumerate(sets)
    ]
    if interval_share is None and method.guided:
        raise ConfigError(
            f"{source}: 'unwrapping' is '{plan.unwrapping}', which needs a calibration and a depth range "
            "(--depth, or 'depth_mm' in plan or rig file); without them, and always to characterise, use a "
            "plan that can be unwrapped by itself: 'hierarchical' or 'heterodyne'"
        )
    wavelengths = method.wavelengths(units)
    if method.spatial:
        if len(sets) > 1 or len(plan.unwrapped_axes) > 1:
            stripes = [unit.stripes for unit in units]
            raise ConfigError(
                f"{source}: 'unwrapping' is '{plan.unwrapping}': {method.advice(stripes, 1, 1)}"
            )
        return WavelengthSequence(axis, sets, tuple(wavelengths), (0.0,), 1.0 / units[0].stripes)
    max_stripes = (1.0 / interval_share if interval_share and method.guided else 1.0) + NEGLIGIBLE
    coarse = [w for w in wavelengths if w.stripes <= max_stripes]
    if not coarse:
        stripes = [unit.stripes for unit in units]
        listed = ", ".join(f"{s:g}" for s in stripes)
        advice = method.advice(stripes, wavelengths[0].stripes, max_stripes)
        raise ConfigError(f"{source}: 'fringes' along {axis} have {listed} stripes: {advice}")
    kept = (coarse[-1], *(w for w in wavelengths if w.stripes > max_stripes))
    trust = _trust(kept, [plan.fringes[i].images for i in sets])
    return WavelengthSequence(axis, sets, kept, trust, interval_share or 1.0)


def check_unwrapping(
    plan: Plan, source: str, interval_shares: Mapping[Axis, float | None] | None = None
) -> None:
    """Refuse a plan that cannot be unwrapped, before anything is projected."""
    # `check_codes` checks axes with codes of other kinds, for which it needs the projector.
    part = plan.fringe_part
    coded = {each.coded_axis for k, each in enumerate(plan.sets) if k not in plan.fringe_indices}
    for axis in part.unwrapped_axes if part else ():
        if part is not None and axis not in coded:
            wavelength_sequence(part, axis, source, (interval_shares or {}).get(axis))


def _trust(wavelengths: tuple[SyntheticWavelength, ...], images: list[int]) -> tuple[float, ...]:
    def variance(wavelength: SyntheticWavelength) -> float:
        return sum(c * c * images[-1] / n for c, n in zip(wavelength.coefficients, images, strict=True))

    predicted = (variance(q) * (r.stripes / q.stripes) ** 2 for q, r in pairwise(wavelengths))
    return (0.0, *(1.0 / (p + variance(r)) for p, r in zip(predicted, wavelengths[1:], strict=True)))
