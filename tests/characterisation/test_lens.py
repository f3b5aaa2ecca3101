"""A lens whose scale differs between poses is told from noise and from a board that moved."""

from __future__ import annotations

import numpy as np

from fpplab.characterisation.lens import breathes
from tests.support.breathing_lens import breathing, fitted, scales


def test_a_lens_that_breathes_is_named_and_a_locked_one_is_not() -> None:
    assert breathes(*scales(fitted(breathing(5e-4, 21))))
    still, sigmas = scales(fitted(breathing(0.0, 22)))
    assert not breathes(still, sigmas)
    assert np.abs(still / sigmas).max() < 4.0


def test_one_pose_alone_is_no_lens() -> None:
    off = np.zeros(9)
    off[4] = 1e-3
    assert not breathes(off, np.full(9, 3e-5))
