"""How far a twin's figures were from its bench's where both are known: the width of every prediction.

For each figure that is a scale (distance, noise) the logarithm of bench over twin is kept, from poses and
scans that the light was not fitted to, as far as there are such; for shares the difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.files import write_text

DISCREPANCY = "discrepancy.yaml"
"""Name of the file, beside the rig file of a matched twin."""
COVERAGE = 1.96
"""Half width of an interval of 95 %, in standard deviations."""
LEAST = 0.02
"""Least standard deviation of a logarithm: what a few poses agree on by chance is not believed."""


class Deviation(Document):
    """What bench and twin differed by, for one figure."""

    mean: float
    """Mean difference, bench less twin; of logarithms for a scale."""
    spread: float
    """Standard deviation of a single comparison."""
    count: int
    """Number of comparisons."""
    fitted: bool
    """Whether the twin was fitted to the same recordings: the deviation is then too small."""

    @classmethod
    def of(cls, differences: Sequence[float], fitted: bool) -> Deviation:
        """Summarise comparisons.

        Parameters
        ----------
        differences : sequence of float
            Bench less twin, at least one.
        fitted : bool
            Whether the twin was fitted to the same recordings.

        Returns
        -------
        Deviation
            A single comparison has its own size as spread.
        """
        values = np.asarray(differences, np.float64)
        spread = float(values.std(ddof=1)) if len(values) > 1 else abs(float(values[0]))
        return cls(mean=float(values.mean()), spread=spread, count=len(values), fitted=fitted)

    @property
    def sigma(self) -> float:
        """Standard deviation with which the next comparison is expected about 0.

        The mean is not corrected for, since it is a fault of the twin which another plan need not share.
        """
        return float(np.sqrt(self.mean**2 + self.spread**2 * (1.0 + 1.0 / self.count) + LEAST**2))


class Discrepancy(Document):
    """What is left between a matched twin and its bench, as its predictions need it."""

    noise: Deviation | None = None
    """Of the logarithm of the noise of the coordinate."""
    distance: Deviation | None = None
    """Of the logarithm of the distance between points and true surface; from scans."""
    completeness: Deviation | None = None
    """Of the share of lit pixels that became points; from scans."""
    looks_like: str | None = None
    """What the difference looks like, where it is large."""
    not_for: str | None = None
    """For which measurements the twin must not be believed."""

    def save(self, folder: Path) -> None:
        """Write the file.

        Parameters
        ----------
        folder : Path
            Of the twin's rig file.
        """
        write_text(folder / DISCREPANCY, config.dump(self))

    @classmethod
    def beside(cls, rig: Path) -> Discrepancy | None:
        """Read the file beside a rig file.

        Parameters
        ----------
        rig : Path
            The rig file.

        Returns
        -------
        Discrepancy or None
            None where there is none: the rig is no matched twin.

        Raises
        ------
        ConfigError
            The file is damaged.
        """
        path = rig.parent / DISCREPANCY
        return config.load_document(path, cls) if path.is_file() else None
