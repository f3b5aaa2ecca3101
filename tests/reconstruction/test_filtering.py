"""The filter against pixels that see two places by formula, and against surfaces that it must leave alone."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.conventions import Floats, Image, Mask, axis_length, phase_of_coordinate, phase_steps
from fpplab.core.errors import DataError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import FilterRules, Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.reconstruction.filtering import Rule, apply_filter, count_removed
from fpplab.reconstruction.points import triangulate

W, H = 120, 90
TURN = RigidTransform.from_vectors(np.array([0.0, -0.33, 0.0]), np.array([150.0, 0.0, 0.0]))
RIG = Calibration(
    Pinhole.from_focal((W, H), (1000.0, 1000.0), (59.5, 44.5)),
    Pinhole.from_focal((912, 1140), (1100.0, 2200.0), (455.5, 569.5)),
    TURN.inverse(),
    {},
)
U, V = np.meshgrid(np.arange(W, dtype=float), np.arange(H, dtype=float))
NEAR, FAR = 440.0, 460.0
EDGE = 60
NOISE = 1.0
"""Standard deviation of a pixel's noise in grey levels of 255."""
AMPLITUDE = 90.0


def plan(*axes: str, **more: object) -> Plan:
    sets = (Sinusoid(axis=axis, stripes=s, steps=6) for axis in axes or ("x",) for s in (1.0, 8.0, 64.0))  # type: ignore[arg-type]
    more = {"filter": FilterRules(), **more}
    return Plan(fringes=tuple(sets), **more)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class Light:
    """What a camera's pixels get from one surface: its true points (H, W, 3), the share of light (H, W)."""

    points: Floats
    share: Floats


def plane(depth: float, across: float = 0.0, shift_px: float | Floats = 0.0) -> Floats:
    """Points where rays `shift_px` beside the pixels' meet a plane, inclined about the camera's v."""
    a, b = (U + shift_px - 59.5) / 1000.0, (V - 44.5) / 1000.0
    z = depth / (1.0 + across * a)
    return np.stack([a * z, b * z, z], axis=-1)


def frames(of: Plan, *lights: Light, coarse_bias: Floats | float = 0.0, seed: int = 0) -> list[Image]:
    """The mixture of the lights under the plan's fringes. coarse_bias: rad, on the set of 8 stripes."""
    noise, images = np.random.default_rng(seed), []
    seen = [RIG.projector.project(light.points, RIG.T_projector_camera) for light in lights]
    for index, step, _ in of.steps():
        fringe = of.fringes[index]
        level = np.zeros((H, W))
        for light, coordinate in zip(lights, seen, strict=True):
            along = coordinate[..., 0 if fringe.axis == "x" else 1]
            phase = phase_of_coordinate(along, fringe.stripes, axis_length(RIG.projector.size, fringe.axis))
            phase = phase + (coarse_bias if fringe.stripes == 8.0 else 0.0)
            level += light.share * (100.0 + AMPLITUDE * np.cos(phase - phase_steps(fringe.steps)[step]))
        images.append(
            np.rint(np.clip(level + noise.normal(0.0, NOISE, level.shape), 0, 255)).astype(np.uint8)
        )
    return images


def measured(of: Plan, images: list[Image]) -> tuple[Decoded, Cloud]:
    decoded = decode(Recording(images, of, RIG.projector.size))
    return decoded, triangulate(decoded, RIG, normals=False)


def removed_from(of: Plan, images: list[Image]) -> np.ndarray:  # type: ignore[type-arg]
    decoded, cloud = apply_filter(*measured(of, images), of, RIG.projector.size)
    assert decoded.removed is not None
    assert len(cloud) == np.count_nonzero(decoded.valid & (decoded.removed == 0))
    return decoded.removed


def wrong(images: list[Image], *truths: Floats) -> Mask:
    """Pixels whose point is more than 5 sigma and 50 µm from every truth along the ray."""
    _, cloud = measured(plan(), images)
    assert cloud.pixels is not None
    assert cloud.sigma_noise_mm is not None
    u, v = cloud.pixels.T
    off = np.min([np.linalg.norm(cloud.points - truth[v, u], axis=1) for truth in truths], axis=0)
    found = np.zeros((H, W), np.bool_)
    found[v, u] = (off > 5.0 * cloud.sigma_noise_mm) & (off > 0.05)
    return found


@pytest.mark.whole_after(1, nightly=2)
@pytest.mark.parametrize("seed", range(3))
def test_mixed_pixels_of_a_step_are_removed_and_nothing_else(seed: int) -> None:
    share = np.where(U < EDGE, 1.0, 0.0)
    # Along the edge the near surface covers from a fifth to four fifths of the pixel.
    share[:, EDGE] = np.linspace(0.2, 0.8, H)
    images = frames(plan(), Light(plane(NEAR), share), Light(plane(FAR), 1.0 - share), seed=seed)
    bad, removed = wrong(images, plane(NEAR), plane(FAR)), removed_from(plan(), images)
    # The masks take a part of the rest.
    assert bad.sum() > 0.5 * H
    assert set(np.flatnonzero(bad.any(axis=0))) == {EDGE}
    assert (removed[bad] > 0).all()
    assert np.mean(removed[bad] == Rule.CONTRADICTION) > 0.9
    assert not removed[U != EDGE].any()


@pytest.mark.parametrize("lit", [0.25, 0.5, 0.75])
def test_a_pixel_at_the_edge_of_shadow_is_removed_for_its_light(lit: float) -> None:
    shift = np.where(U == EDGE, -(1.0 - lit) / 2.0, 0.0)
    share = np.where(U < EDGE, 1.0, np.where(U == EDGE, lit, 0.0))
    images = frames(plan(), Light(plane(NEAR, shift_px=shift), share))
    bad, removed = wrong(images, plane(NEAR)), removed_from(plan(), images)
    assert np.mean(bad[:, EDGE]) > 0.7
    # A middle half a lit width beside the pixel's ray, on rays that meet at 0.33 rad.
    _, cloud = measured(plan(), images)
    off = np.abs(cloud.points[cloud.pixels[:, 0] == EDGE, 2] - NEAR).mean()  # type: ignore[index]
    assert off == pytest.approx((1.0 - lit) / 2.0 * NEAR / 1000.0 / np.tan(0.33), rel=0.1)
    assert (removed[:, EDGE] == Rule.HALF_LIT).all()
    assert not removed[:, :EDGE].any()


@pytest.mark.parametrize("axes", [("x",), ("x", "y")])
@pytest.mark.parametrize("across", [0.0, 2.0, -1.5, 4.0])
def test_smooth_surfaces_are_kept_however_steep(across: float, axes: tuple[str, ...]) -> None:
    """Up to 76° from the image plane; χ² of two degrees of freedom passes 4² each once in 10⁷."""
    light = Light(plane(NEAR, across), np.ones((H, W)))
    assert not removed_from(plan(*axes), frames(plan(*axes), light)).any()


@pytest.mark.parametrize("ends", ["left", "right", "above", "below"])
def test_light_that_falls_gradually_towards_an_edge_is_no_shadow(ends: str) -> None:
    """By 30 % over the whole surface, and by 2 % over as far as a pixel is compared with."""
    along, length = (U, W) if ends in ("left", "right") else (V, H)
    along = along if ends in ("right", "below") else length - 1 - along
    share = np.where(along < 0.6 * length, 1.0 - 0.3 * along / (0.6 * length), 0.0)
    removed = removed_from(plan(), frames(plan(), Light(plane(NEAR), share)))
    assert not removed[share > 0].any()


def test_ink_on_a_surface_is_kept() -> None:
    ink = np.where((np.abs(U - 60) < 20) & (np.abs(V - 45) < 20), 0.3, 1.0)
    assert not removed_from(plan(), frames(plan(), Light(plane(NEAR), ink))).any()


def test_loss_of_light_that_noise_explains_is_none() -> None:
    """At an edge with a modulation of 7 grey levels, whose noise is 8 % of it."""
    share = np.where(U < EDGE, 0.08, 0.0)
    removed = removed_from(plan(), frames(plan(), Light(plane(NEAR), share)))
    # The greatest of forty neighbours beats 10 % nearly everywhere; 5 sigma of it nearly nowhere.
    assert np.count_nonzero(removed[:, EDGE - 1] == Rule.HALF_LIT) <= 0.05 * H


FLYING = FilterRules(disagreement_max=0.0, light_min=0.0, patch_min=1)


def between_two_planes(seed: int = 0) -> tuple[Decoded, Cloud]:
    """Along the edge of the near plane pixels see both; wide fringes give a coordinate between the two."""
    coarse = Plan(fringes=tuple(Sinusoid(axis="x", stripes=s, steps=6) for s in (1.0, 8.0)))
    share = np.where(U < EDGE, 1.0, 0.0)
    share[:, EDGE] = np.linspace(0.2, 0.8, H)
    return measured(
        coarse, frames(coarse, Light(plane(NEAR), share), Light(plane(FAR), 1.0 - share), seed=seed)
    )


@pytest.mark.parametrize("seed", range(3))
def test_points_between_two_surfaces_are_removed_without_a_look_at_their_light(seed: int) -> None:
    """A pixel that is joined with those above and below it only, six are across a jump; edges stay whole."""
    decoded, cloud = between_two_planes(seed)
    between = (cloud.points[:, 2] > NEAR + 5.0) & (cloud.points[:, 2] < FAR - 5.0)
    assert between.sum() > 0.4 * H
    decoded, cloud = apply_filter(decoded, cloud, plan(filter=FLYING), RIG.projector.size)
    between = (cloud.points[:, 2] > NEAR + 5.0) & (cloud.points[:, 2] < FAR - 5.0)
    assert not between.any()
    assert decoded.removed is not None
    assert not decoded.removed[U != EDGE].any()
    assert set(np.unique(decoded.removed)) == {0, Rule.FLYING}


@pytest.mark.parametrize("across", [0.0, 4.0])
def test_noise_alone_makes_no_point_fly(across: float) -> None:
    """Steps from pixel to pixel of 3 mm, more than the steepest surface has, are noise here."""
    coarse = plan(filter=FLYING).model_copy(update={"fringes": (Sinusoid(axis="x", stripes=0.9, steps=6),)})
    images = frames(coarse, Light(plane(NEAR, across), np.full((H, W), 0.5)))
    _, cloud = measured(coarse, images)
    assert cloud.sigma_noise_mm is not None
    assert np.median(cloud.sigma_noise_mm) > 2.0
    assert np.count_nonzero(removed_from(coarse, images)) <= 1e-3 * W * H


def test_the_rule_of_flying_points_can_be_left_out() -> None:
    decoded, _ = apply_filter(
        *between_two_planes(),
        plan(filter=FLYING.model_copy(update={"flying": False})),
        RIG.projector.size,
    )
    assert decoded.removed is not None
    assert not decoded.removed.any()


@pytest.mark.parametrize(("side", "kept"), [(1, False), (4, False), (5, True)])
def test_patches_are_kept_from_twenty_five_pixels_on(side: int, kept: bool) -> None:
    decoded, _ = measured(plan(), frames(plan(), Light(plane(NEAR), np.ones((H, W)))))
    stray = (slice(40, 40 + side), slice(50, 50 + side))
    decoded.u[stray] += 912.0 / 64.0
    # Corners of the patch of 25 would be flying points: most of their neighbours are of the plane.
    rules = plan(filter=FilterRules(flying=False))
    result, cloud = apply_filter(decoded, triangulate(decoded, RIG, normals=False), rules, RIG.projector.size)
    assert result.removed is not None
    assert (result.removed[stray] == (0 if kept else Rule.ISOLATED)).all()
    assert np.count_nonzero(result.removed) == (0 if kept else side**2)
    assert len(cloud) == W * H - np.count_nonzero(result.removed)


def test_disagreement_is_one_where_only_noise_disagrees() -> None:
    light = Light(plane(NEAR), np.ones((H, W)))
    for axes, freedom in ((("x",), 2), (("x", "y"), 4)):
        decoded, _ = measured(plan(*axes), frames(plan(*axes), light))
        assert decoded.disagreement is not None
        # χ² scatters by √(2/ν), and the noise found in the frames by two percent.
        tolerance = 5.0 * (np.sqrt(2.0 / freedom / (W * H)) + 0.02)
        assert np.mean(decoded.disagreement**2) == pytest.approx(1.0, abs=tolerance)
    single = Plan(fringes=(Sinusoid(axis="x", stripes=0.9, steps=6),))
    decoded = decode(Recording(frames(single, light), single, RIG.projector.size))
    assert decoded.disagreement is not None
    assert not decoded.disagreement[decoded.valid].any()


def test_what_all_pixels_suffer_is_held_against_none() -> None:
    """A bias of ten times the noise on a coarse set: of few pixels a contradiction, of all none."""
    light, bias = Light(plane(NEAR), np.ones((H, W))), 10.0 * NOISE / AMPLITUDE
    few = np.where((np.abs(U - 60) < 3) & (np.abs(V - 45) < 3), bias, 0.0)
    removed = removed_from(plan(), frames(plan(), light, coarse_bias=few))
    assert (removed[few > 0] == Rule.CONTRADICTION).all()
    assert not removed[few == 0].any()
    assert not removed_from(plan(), frames(plan(), light, coarse_bias=bias)).any()


def test_without_a_filter_all_comes_back_as_it_was() -> None:
    unfiltered = plan(filter=None)
    decoded, cloud = measured(unfiltered, frames(unfiltered, Light(plane(NEAR), np.ones((H, W)))))
    assert apply_filter(decoded, cloud, unfiltered, RIG.projector.size) == (decoded, cloud)
    assert count_removed(decoded) is None


def test_a_filter_that_leaves_nothing_is_refused() -> None:
    all_of_it = plan(filter=FilterRules(patch_min=W * H + 1))
    images = frames(all_of_it, Light(plane(NEAR), np.ones((H, W))))
    with pytest.raises(DataError, match="removes all 10800 points"):
        apply_filter(*measured(all_of_it, images), all_of_it, RIG.projector.size)


def test_points_that_stay_keep_what_is_known_of_them() -> None:
    decoded, _ = measured(plan(), frames(plan(), Light(plane(NEAR), np.ones((H, W)))))
    decoded.u[40:42, 50:52] += 912.0 / 64.0
    cloud = triangulate(decoded, RIG)
    result, kept = apply_filter(decoded, cloud, plan(), RIG.projector.size)
    assert cloud.pixels is not None
    assert result.removed is not None
    stays = result.removed[cloud.pixels[:, 1], cloud.pixels[:, 0]] == 0
    for name in ("points", "pixels", "sigma_noise_mm"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(cloud, name)[stays])
    assert kept.normals is not None
    # Beside the strays, whose depth would have spoilt them.
    np.testing.assert_allclose(kept.normals, [[0.0, 0.0, -1.0]] * len(kept), atol=0.2)
    none = dict.fromkeys(("contradiction", "half_lit", "flying"), 0)
    assert count_removed(result) == {**none, "isolated": 4, "share": 4 / (W * H)}


def test_maps_keep_disagreement_and_removal_on_disk(tmp_path: Path) -> None:
    decoded, _ = measured(plan(), frames(plan(), Light(plane(NEAR), np.ones((H, W)))))
    marked = replace(decoded, removed=np.full((H, W), Rule.ISOLATED, np.uint8))
    marked.save(tmp_path / "maps.npz")
    again = Decoded.load(tmp_path / "maps.npz")
    np.testing.assert_array_equal(again.removed, marked.removed)
    np.testing.assert_array_equal(again.disagreement, marked.disagreement)
    replace(decoded, disagreement=None).save(tmp_path / "bare.npz")
    bare = Decoded.load(tmp_path / "bare.npz")
    assert bare.disagreement is None
    assert bare.removed is None
