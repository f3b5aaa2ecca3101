"""Blurred prints: the blur of an edge, and what is kept of earlier prints."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from sim.light.blurred_pictures import SIZE_RATIO, BlurredPictureCache, BlurredPictures, unblurred_picture

SCALE = (10.0, 10.0)
"""Pixels per mm."""


def _half(columns: int = 200, rows: int = 120) -> NDArray[np.uint8]:
    """Ground on the right half."""
    picture = np.zeros((rows, columns), np.uint8)
    picture[:, columns // 2 :] = 255
    return picture


def _middle_row(prints: BlurredPictures, size: int) -> NDArray[np.float32]:
    picture = prints.pictures[size]
    return picture[len(picture) // 2, prints.rim[0] : picture.shape[1] - prints.rim[0]]


def test_an_edge_is_blurred_to_the_integral_of_a_normal_distribution() -> None:
    picture = _half()
    prints = BlurredPictureCache().blurred(picture, SCALE, 0.04, 0.09)
    assert prints.variances_mm2[0] <= 0.04
    assert prints.variances_mm2[-1] >= 0.09
    place = (np.arange(200) - 99.5) / SCALE[0]
    for size, variance in enumerate(prints.variances_mm2):
        inner = np.abs(place) < 5  # beyond, what is not the item is blurred into it
        wanted = norm.cdf(place[inner] / np.sqrt(variance))
        np.testing.assert_allclose(_middle_row(prints, size)[inner], wanted, atol=5e-3)


def test_the_share_of_the_item_falls_to_half_at_its_edge() -> None:
    prints = BlurredPictureCache().blurred(_half(), SCALE, 0.04, 0.09)
    edge = prints.rim[0]
    of_edge = prints.across[:, edge - 1 : edge + 1].mean(axis=1)
    np.testing.assert_allclose(of_edge, 0.5, atol=2e-3)
    np.testing.assert_allclose(prints.across[:, edge + 100], 1.0, atol=1e-3)


def test_prints_of_several_pictures_are_kept() -> None:
    cache, pictures = BlurredPictureCache(), [_half(), _half(240, 160)]
    first = [cache.blurred(one, SCALE, 0.04, 0.09) for one in pictures]
    again = [cache.blurred(one, SCALE, 0.05, 0.08) for one in pictures]
    assert all(a is b for a, b in zip(first, again, strict=True))


def test_prints_of_near_and_far_poses_are_blurred_once_for_all() -> None:
    """A paper board before a camera of 1368 x 912: near poses are drawn at 32 px/mm, far ones at 16."""
    cache, fine, coarse = BlurredPictureCache(), np.zeros((1344, 1920), np.uint8), _half(672, 960)
    asked = [(fine, 32.0, -46, -38), (coarse, 16.0, -47, -33), (fine, 32.0, -45, -34), (fine, 32.0, -47, -41)]

    def blurred() -> list[BlurredPictures]:
        return [
            cache.blurred(picture, (scale, scale), SIZE_RATIO ** (first + 0.5), SIZE_RATIO ** (last + 0.5))
            for picture, scale, first, last in asked
        ]

    blurred()
    again = blurred()
    assert all(a is b for a, b in zip(again, blurred(), strict=True))


def test_more_sizes_change_nothing_for_those_that_were_there() -> None:
    cache, picture = BlurredPictureCache(), _half()
    few = cache.blurred(picture, SCALE, 0.04, 0.05)
    more = cache.blurred(picture, SCALE, 0.04, 0.2)
    assert len(more.variances_mm2) > len(few.variances_mm2)
    np.testing.assert_allclose(more.variances_mm2[: len(few.variances_mm2)], few.variances_mm2)
    for size in range(len(few.variances_mm2)):
        np.testing.assert_array_equal(_middle_row(few, size), _middle_row(more, size))


def test_the_least_used_prints_are_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    cache, pictures = BlurredPictureCache(), [_half(), _half(240, 160), _half(260, 100)]
    held = cache.blurred(pictures[0], SCALE, 0.04, 0.05)
    monkeypatch.setattr("sim.light.blurred_pictures.KEEP_BYTES", held.pictures.nbytes)
    for one in pictures[1:]:
        cache.blurred(one, SCALE, 0.04, 0.05)
    assert cache.blurred(pictures[0], SCALE, 0.04, 0.05) is not held


def test_without_a_picture_everything_is_ground() -> None:
    prints = unblurred_picture(None)
    assert prints.pictures.tolist() == [[[1.0]]]
    assert prints.rim == (0, 0)
