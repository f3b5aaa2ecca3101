"""Connected regions against SciPy's labels."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fpplab.reconstruction.filtering import mark_small_regions

H, W = 150, 90  # several bands


@pytest.mark.parametrize("share", [0.5, 0.7, 0.95])
def test_small_regions_are_those_of_a_graph(share: float) -> None:
    random = np.random.default_rng(int(100 * share))
    w = np.where(random.random((H, W)) < 0.9, 1.0, np.nan).astype(np.float32)
    across, down = random.random((2, H, W)) < share
    removed = np.zeros((H, W), np.uint8)
    mark_small_regions(w, across, down, 12, removed, 3)
    number, there = np.arange(H * W).reshape(H, W), np.isfinite(w)
    rows = across[:, :-1] & there[:, :-1] & there[:, 1:]
    columns = down[:-1] & there[:-1] & there[1:]
    one = np.concatenate([number[:, :-1][rows], number[:-1][columns]])
    other = np.concatenate([number[:, 1:][rows], number[1:][columns]])
    graph = coo_array((np.ones(len(one)), (one, other)), (H * W, H * W))
    _, label = connected_components(graph, directed=False)
    small = (np.bincount(label)[label] < 12).reshape(H, W) & there
    assert small.any()
    np.testing.assert_array_equal(removed, np.where(small, 3, 0))
