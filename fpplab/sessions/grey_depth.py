"""How many bits the grey levels of images have, found from the levels that occur or confirmed by them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Image, Mask, full_scale
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.progress import Say
from fpplab.sessions.limits import SESSION_LIMITS as LIMITS

BIT_DEPTHS = (8, 10, 12, 14, 16)
STORED_BITS = 16  # bits of a stored grey level where it has more than 8: what TIFF and PNG hold


def check_bits(bits: int | None) -> None:
    if bits is not None and bits not in BIT_DEPTHS:
        raise ConfigError(f"--bits is {bits}: one of {', '.join(map(str, BIT_DEPTHS))}")


@dataclass(eq=False)
class StoredLevels:
    """The grey levels that occur in 16-bit files, whatever the depth of the camera."""

    occurring: Mask = field(
        default_factory=lambda: np.zeros(1 << STORED_BITS, np.bool_)
    )  # whether a level occurs
    greatest: int = -1  # the greatest level
    where: str = ""  # the first image that has it

    def add(self, image: Image, name: str) -> None:
        # image (height, width)
        self.occurring[image.ravel()] = True
        if (brightest := int(image.max())) > self.greatest:
            self.greatest, self.where = brightest, name

    @property
    def levels(self) -> NDArray[np.int64]:
        return np.flatnonzero(self.occurring).astype(np.int64)

    def depth(self, bits: int | None, warn: Say, tell: Say) -> tuple[int, int]:
        return self._detect_bits(tell) if bits is None else self._confirm_bits(bits, warn)

    def _detect_bits(self, tell: Say) -> tuple[int, int]:
        upper = self._upper_bits()
        if upper is not None:
            tell(f"the images hold {upper} bits, in the upper bits of 16; they were moved to the lower ones")
            return upper, STORED_BITS - upper
        possible = [depth for depth in BIT_DEPTHS if self.greatest <= full_scale(depth)]
        if len(possible) > 1 and self.greatest < full_scale(possible[0]):
            depths = ", ".join(map(str, possible[:-1]))
            raise ConfigError(
                f"--bits is missing: the grey levels reach {self.greatest} ({self.where}), so that the "
                f"camera has {depths} or {possible[-1]} bits; say how many"
            )
        tell(f"the grey levels reach {self.greatest}: {possible[0]} bits")
        return possible[0], 0

    def _confirm_bits(self, bits: int, warn: Say) -> tuple[int, int]:
        if self.greatest > full_scale(bits):
            if not _fills_upper(self.levels, bits):
                raise DataError(
                    f"{self.where}: has a grey level of {self.greatest}, more than {bits} bits hold; "
                    "see --bits"
                )
            warn(
                f"the {bits} bits are the upper ones of 16 in these images; they were moved to the lower ones"
            )
            return bits, STORED_BITS - bits
        upper = self._upper_bits()
        if bits == STORED_BITS and upper is not None:
            warn(
                f"the grey levels lie {1 << STORED_BITS - upper} apart: the images seem to hold {upper} bits "
                f"in the upper bits of 16; with --bits {upper} saturated pixels are recognised"
            )
        fewer = next(
            (depth for depth in BIT_DEPTHS if depth < bits and self.greatest == full_scale(depth)), None
        )
        if fewer is not None:
            warn(
                f"the grey levels end at {self.greatest}, the full scale of {fewer} bits; with --bits "
                f"{fewer} saturated pixels are recognised"
            )
        return bits, 0

    def _upper_bits(self) -> int | None:
        """The depth of levels that were shifted or scaled to 16 bits; None where nothing tells."""
        levels = self.levels
        if len(levels) < LIMITS.min_grey_levels:
            return None
        fitting = (d for d in BIT_DEPTHS[:-1] if self.greatest > full_scale(d) and _fills_upper(levels, d))
        return next(fitting, None)


def _fills_upper(levels: NDArray[np.int64], bits: int) -> bool:
    """Whether levels of some bits were shifted to the upper ones of 16, or scaled to the full range."""
    own = levels >> STORED_BITS - bits
    scaled = own * (full_scale(STORED_BITS) / full_scale(bits))
    return bool(np.all(levels == own << STORED_BITS - bits) or np.all(np.abs(levels - scaled) <= 1))
