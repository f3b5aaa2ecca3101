"""Phase-shifted sinusoids with equal steps, the kind of a fringe set that names none."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from fpplab.core.conventions import Floats, phase_steps
from fpplab.patterns.fringe_sets.base import Demodulation, SteppedFringes


class Sinusoid(SteppedFringes):
    """N images of a sinusoid, each shifted by 2π/N: the equation is in `fpplab.core.conventions`.

    Fringes made elsewhere are described too: image n is
    `cos(2π stripes (u + 0.5)/W + phase_origin_rad - shift_sign δ_n)`.
    """

    kind: Annotated[Literal["sinusoid"], Field(exclude=True)] = "sinusoid"
    """`sinusoid`; may be left out."""

    def wave(self, phase: Floats, step: int) -> Floats:
        """Give `0.5 + 0.5 cos(Φ + origin - δ_n)`, which neither clips nor wastes range."""
        shifted = phase + self.phase_origin_rad - self.shift_sign * phase_steps(self.steps)[step]
        return np.asarray(0.5 + 0.5 * np.cos(shifted))

    def demodulation(self) -> Demodulation:
        """Give the weights of `φ = atan2(Σ I_n sin δ_n, Σ I_n cos δ_n)`."""
        shift = phase_steps(self.steps)
        return Demodulation(
            sine=np.asarray(self.shift_sign * np.sin(shift), np.float64),
            cosine=np.cos(shift),
            mean=np.full(self.steps, 1.0 / self.steps),
            scale=2.0 / self.steps,
            origin_rad=self.phase_origin_rad,
        )
