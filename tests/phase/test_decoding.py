"""Decoding inverts encoding; noise, masks and refusals are as documented."""

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from fpplab.core.conventions import Lattice, axis_length, mirror_centres
from fpplab.core.errors import Cancelled, ConfigError, DataError
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import MaskRules, Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode, wrapped_phase
from fpplab.phase.kernels import _arctangent_in_turns
from fpplab.phase.precision import coordinate_uncertainty, phase_uncertainty

SIZE = (912, 40)
FULL16 = 65535


def make_plan(*sets, **more):
    return Plan(fringes=tuple(Sinusoid(axis=a, stripes=float(s), steps=n) for a, s, n in sets), **more)


def render(plan, size=SIZE, lattice=Lattice.SQUARE, offset=0.5, amplitude=0.4):
    """Levels 0 … 1 of every image, seen by a perfect camera with one pixel per mirror."""
    return [
        offset + 2 * amplitude * (plan.fringes[i].level(n, size, lattice) - 0.5) for i, n, _ in plan.steps()
    ]


def record(levels, bits=8, noise=0.0, seed=0):
    """Quantise levels as a camera does, with noise in 8-bit grey levels."""
    generator, full = np.random.default_rng(seed), (1 << bits) - 1
    dtype = np.uint8 if bits == 8 else np.uint16
    return [
        np.clip(np.rint(full * (x + noise / 255 * generator.standard_normal(x.shape))), 0, full).astype(dtype)
        for x in levels
    ]


def seen_from(u, plan, width=SIZE[0], amplitude=0.4, bias=0.0):
    """Levels of a scene with the coordinate map u; `bias` in rad is added to the coarsest set."""
    levels = []
    for index, n, _ in plan.steps():
        fringe = plan.fringes[index]
        phase = 2 * np.pi * fringe.stripes * (u + 0.5) / width + (bias if index == 0 else 0.0)
        levels.append(0.5 + amplitude * np.cos(phase - 2 * np.pi * n / fringe.steps))
    return levels


X3 = make_plan(("x", 1, 12), ("x", 8, 12), ("x", 64, 12))


@pytest.mark.whole
@pytest.mark.parametrize("lattice", list(Lattice))
@pytest.mark.parametrize(
    "plan",
    [
        X3,
        make_plan(("y", 0.9, 3), ("y", 3.3, 4), ("y", 15, 5)),
        make_plan(("y", 10, 7), ("x", 142.05, 4), ("x", 1, 3), ("y", 1, 3), ("x", 9.43, 3)),
        make_plan(("x", 64, 4), ("x", 49, 3), ("x", 56, 5), unwrapping="heterodyne"),
    ],
    ids=["x", "y", "both", "heterodyne"],
)
def test_decoding_inverts_encoding(plan, lattice):
    decoded = decode(Recording(record(render(plan, lattice=lattice), 16), plan, SIZE, bits=16))
    u, v = mirror_centres(SIZE, lattice)
    # The diamond's last mirror of an odd row ends half a pixel beyond W, where stripes may repeat.
    inner = u < SIZE[0] - 0.5
    assert decoded.valid[inner].all()
    for axis, found, truth in (("x", decoded.u, u), ("y", decoded.v, v)):
        if axis in plan.axes:
            np.testing.assert_allclose(found[decoded.valid], truth[decoded.valid], atol=1e-3)
        else:
            assert np.isnan(found).all()
    np.testing.assert_allclose(decoded.modulation[inner], 0.4 * FULL16 / 256, rtol=1e-3)
    assert {m.dtype for m in (decoded.u, decoded.v, decoded.modulation, decoded.sigma)} == {np.dtype("f4")}


@settings(deadline=None, max_examples=8)
@given(
    steps=st.lists(st.integers(3, 13), min_size=3, max_size=3),
    base=st.floats(0.6, 1.0),
    ratios=st.tuples(st.floats(1.5, 10), st.floats(1.5, 10)),
    sign=st.sampled_from([1, -1]),
    origin=st.floats(-20, 20),
    axis=st.sampled_from(["x", "y"]),
)
def test_decoding_inverts_any_encoding(steps, base, ratios, sign, origin, axis):
    stripes = (base, base * ratios[0], base * ratios[0] * ratios[1])
    fringes = tuple(
        Sinusoid(axis=axis, stripes=s, steps=n, shift_sign=sign, phase_origin_rad=origin * (k + 1))
        for k, (s, n) in enumerate(zip(stripes, steps, strict=True))
    )
    plan, size = Plan(fringes=fringes), (300, 2) if axis == "x" else (2, 300)
    decoded = decode(Recording(record(render(plan, size), 16), plan, size, bits=16))
    truth = mirror_centres(size, Lattice.SQUARE)[0 if axis == "x" else 1]
    assert decoded.valid.all()
    np.testing.assert_allclose(decoded.u if axis == "x" else decoded.v, truth, atol=2e-3)


def test_eight_bits_cost_what_rounding_costs():
    decoded = decode(Recording(record(render(X3)), X3, SIZE))
    rounding = coordinate_uncertainty(phase_uncertainty(np.sqrt(1 / 12), 0.4 * 255, 12), 64, SIZE[0])
    rms = np.sqrt(np.mean((decoded.u - mirror_centres(SIZE, Lattice.SQUARE)[0]) ** 2))
    # Here 0.004 px: frames half a turn apart round alike, so twelve count as six.
    assert 0.5 * rounding < rms < 2.0 * rounding


@pytest.mark.parametrize(
    ("plan", "bits"),
    [
        (X3, 8),
        (make_plan(("x", 1, 3), ("x", 8, 3), ("x", 64, 3)), 8),
        (make_plan(("x", 1, 4), ("x", 7.5, 5), ("x", 50, 4), ("y", 1, 3)), 12),
        (make_plan(("x", 49, 6), ("x", 56, 6), ("x", 64, 6), unwrapping="heterodyne"), 8),
    ],
)
def test_sigma_is_the_scatter(plan, bits):
    decoded = decode(Recording(record(render(plan), bits, noise=2.0, seed=1), plan, SIZE, bits=bits))
    error = decoded.u - mirror_centres(SIZE, Lattice.SQUARE)[0]
    assert np.nanstd(error / decoded.sigma) == pytest.approx(1.0, abs=0.1)
    # A single stripe leaves it open near the edges which of them is meant: half a row of forty here.
    assert decoded.valid.mean() > (0.98 if "y" in plan.axes else 0.99)


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("steps", [3, 4, 12])
@pytest.mark.parametrize("stripes", [(1, 8, 64), (1, 9.43, 142.05), (0.9, 7, 50)])
def test_no_fringe_is_thrown_at_the_edges(stripes, steps, axis):
    plan = make_plan(*((axis, s, steps) for s in stripes))
    edge = np.array([0, 1, SIZE[0] - 2, SIZE[0] - 1])
    size = (SIZE[0], 2) if axis == "x" else (2, SIZE[0])
    levels = [x[:, edge] if axis == "x" else x[edge].T for x in render(plan, size)]
    frames = record([np.repeat(x[:1], 5000, axis=0) for x in levels], noise=1.5, seed=steps)
    decoded = decode(Recording(frames, plan, size))
    error = (decoded.u if axis == "x" else decoded.v) - edge
    assert np.nanmax(np.abs(error / decoded.sigma)) < 6
    assert decoded.valid.mean() > 0.995


@pytest.mark.parametrize("steps", [4, 5, 8, 12])
def test_n_steps_are_immune_to_harmonics_up_to_n_minus_two(steps):
    fringe = Sinusoid(axis="x", stripes=3, steps=steps)
    u = np.arange(300.0)[None]
    theta = 2 * np.pi * 3 * (u + 0.5) / 300

    def error(harmonic):
        shifted = [theta - 2 * np.pi * n / steps for n in range(steps)]
        frames = [100 + 50 * np.cos(t) + 10 * np.cos(harmonic * t) for t in shifted]
        phase = wrapped_phase(frames, fringe).phase
        return np.abs(np.angle(np.exp(1j * (phase - theta)))).max()

    assert all(error(h) < 1e-5 for h in range(2, steps - 1))
    assert error(steps - 1) > 0.1


def test_wrapped_phase_is_phase_modulation_and_offset():
    fringe = Sinusoid(axis="x", stripes=2.5, steps=5, shift_sign=-1, phase_origin_rad=1.3)
    levels = render(Plan(fringes=(fringe,)), offset=100.0, amplitude=30.0)
    found = wrapped_phase(levels, fringe)
    truth = 2 * np.pi * 2.5 * (mirror_centres(SIZE, Lattice.SQUARE)[0] + 0.5) / SIZE[0]
    np.testing.assert_allclose(np.exp(1j * found.phase), np.exp(1j * truth), atol=1e-5)
    assert found.phase.min() >= 0
    assert found.phase.max() < np.float32(2 * np.pi)
    np.testing.assert_allclose(found.modulation, 30, rtol=1e-5)
    np.testing.assert_allclose(found.offset, 100, rtol=1e-5)
    np.testing.assert_allclose(found.misfit, 0, atol=1e-4)
    with pytest.raises(DataError, match="5 images was given 4 frames"):
        wrapped_phase(levels[:4], fringe)


def test_the_arctangent_is_good_to_a_millionth():
    angle = np.concatenate([np.linspace(1e-4, 2 * np.pi - 1e-4, 4001), np.arange(1, 8) * np.pi / 4])
    for radius in (1e-3, 1.0, 1e5):
        found = [
            _arctangent_in_turns(np.float32(radius * np.sin(a)), np.float32(radius * np.cos(a)))
            for a in angle
        ]
        assert np.abs(2 * np.pi * np.array(found) - angle).max() < 1e-6


def test_the_masks_are_those_of_quality():
    generator = np.random.default_rng(4)
    rules = MaskRules(modulation_min=10, contrast_min=0.2, residual_max=0.1)
    plan = make_plan(("x", 1, 5), ("x", 6, 4), ("y", 1, 3), masks=rules)
    shape, sets = (SIZE[1], SIZE[0]), len(plan.fringes)
    offset, amplitude = generator.uniform(0.1, 0.9, shape), generator.uniform(0.0, 0.15, (sets, *shape))
    frames = []
    for (index, _, _), level in zip(plan.steps(), render(plan, offset=0, amplitude=1), strict=True):
        frames.append(offset + amplitude[index] * (level + generator.uniform(-0.15, 0.15, shape)))
    frames[6][::5, ::3] = frames[7][::5, ::3] = 1.0  # two of four samples: the others do not give a phase
    frames = record(frames)
    expected = np.ones(shape, bool)
    doubtful = np.zeros(shape, bool)
    start = 0
    for fringe in plan.fringes:
        w = wrapped_phase(frames[start : start + fringe.steps], fringe, 255)
        start += fringe.steps
        expected &= (w.modulation >= rules.modulation_min) & (w.modulation >= rules.contrast_min * w.offset)
        expected &= (w.misfit <= rules.residual_max * w.modulation) & (w.peak < 255)
        for a, b in ((w.modulation, 10), (w.modulation, 0.2 * w.offset), (w.misfit, 0.1 * w.modulation)):
            doubtful |= np.abs(a - b) < 1e-2
    decoded = decode(Recording(frames, plan, SIZE))
    # At the edge of repeating stripes masks are not all that counts.
    doubtful[:, :120] = doubtful[:, -120:] = True
    doubtful[:8] = doubtful[-8:] = True
    assert 0.05 < expected[~doubtful].mean() < 0.8
    np.testing.assert_array_equal(decoded.valid[~doubtful], expected[~doubtful])
    for values in (decoded.u, decoded.v, decoded.modulation, decoded.sigma):
        np.testing.assert_array_equal(np.isfinite(values), decoded.valid)


@pytest.mark.parametrize("steps", [3, 5, 8, 13])
def test_the_misfit_is_what_least_squares_leave(steps):
    rules = MaskRules(modulation_min=0, contrast_min=0, residual_max=0.1, wrong_order_max=1)
    plan = make_plan(("x", 1, steps), masks=rules)
    noise = np.random.default_rng(steps).standard_normal((steps, SIZE[1], SIZE[0]))
    noise *= np.linspace(0, 0.05, SIZE[1])[:, None]  # up to twice the limit
    frames = record(np.array(render(plan, amplitude=0.25)) + noise)
    shift = 2 * np.pi * np.arange(steps) / steps
    waves = np.stack([np.ones(steps), np.cos(shift), np.sin(shift)], axis=1)
    seen = np.reshape(frames, (steps, -1)).astype(float)
    fitted = np.linalg.lstsq(waves, seen, rcond=None)[0]
    misfit = np.sqrt(np.mean((seen - waves @ fitted) ** 2, axis=0)) / np.hypot(fitted[1], fitted[2])
    misfit = misfit.reshape(SIZE[::-1])[:, 100:-100]  # a single stripe is ambiguous at the edges
    known = np.abs(misfit - 0.1) > 1e-3
    valid = decode(Recording(frames, plan, SIZE)).valid[:, 100:-100]
    np.testing.assert_array_equal(valid[known], (misfit < 0.1)[known])


def test_every_frequency_must_be_modulated():
    levels = render(X3)
    for level in levels[12:24]:
        level[:, 100:200] = 0.5
    valid = decode(Recording(record(levels), X3, SIZE)).valid
    assert not valid[:, 100:200].any()
    assert valid[:, :100].all()
    assert valid[:, 200:].all()


def test_an_order_in_dispute_is_rejected():
    plan = make_plan(("x", 1, 4), ("x", 16, 4), masks=MaskRules(disagreement_max=0.3))
    u = np.tile(np.linspace(100, 800, 400), (8, 1))
    for share, kept in ((0.25, True), (0.35, False)):
        levels = seen_from(u, plan, bias=2 * np.pi * share / 16)
        decoded = decode(Recording(record(levels, 16), plan, SIZE, bits=16))
        assert decoded.valid.all() == decoded.valid.any() == kept


def test_twelve_bits_are_told_in_eight_bit_greys():
    eight, twelve = (decode(Recording(record(render(X3), b, 1.0), X3, SIZE, bits=b)) for b in (8, 12))
    np.testing.assert_allclose(twelve.modulation, eight.modulation, rtol=0.05)
    assert np.nanmedian(twelve.sigma) == pytest.approx(np.nanmedian(eight.sigma), rel=0.1)


def test_memory_maps_crops_and_foreign_bytes_decode_alike(tmp_path):
    frames = record(render(X3), 12)
    expected = decode(Recording(frames, X3, SIZE, bits=12))
    mapped = []
    for n, frame in enumerate(frames):
        tifffile.imwrite(tmp_path / f"{n}.tif", frame, byteorder=">")
        mapped.append(tifffile.memmap(tmp_path / f"{n}.tif", mode="r"))
    crops = [np.pad(f, 3)[3:-3, 3:-3] for f in frames]
    for variant in (mapped, crops):
        found = decode(Recording(variant, X3, SIZE, bits=12))
        np.testing.assert_array_equal(found.u, expected.u)


def test_progress_rises_to_one_and_may_cancel():
    told = []
    frames = [np.tile(f, (20, 1)) for f in record(render(X3))]
    decode(Recording(frames, X3, SIZE), progress=told.append)
    assert told == sorted(told)
    assert len(told) > 1
    assert told[-1] == 1.0

    def cancel(_):
        raise Cancelled("by the user")

    with pytest.raises(Cancelled):
        decode(Recording(frames, X3, SIZE), progress=cancel)


GOOD = record(render(X3, (912, 4)))


@pytest.mark.parametrize(
    ("frames", "bits", "message"),
    [
        (GOOD[:-1], 8, "scan: holds 35 frames, but the plan takes 36"),
        ([], 8, "scan: holds 0 frames, but the plan takes 36"),
        ([*GOOD[:-1], GOOD[0][:, :-1]], 8, "scan: frame 35 is 911 x 4 pixels, but frame 0 is 912 x 4"),
        ([*GOOD[:-1], GOOD[0].astype(np.uint16)], 8, "scan: frame 35 is uint16, but frame 0 is uint8"),
        ([f.astype(np.float32) for f in GOOD], 8, "scan: frames are float32; raw frames are uint8 or uint16"),
        ([f[..., None] for f in GOOD], 8, r"scan: frame 0 has the shape \(4, 912, 1\)"),
        ([f[:0] for f in GOOD], 8, r"scan: frame 0 has the shape \(0, 912\)"),
        (GOOD, 12, "scan: frames are uint8.* 12 bits"),
        ([f.astype(np.uint16) * 257 for f in GOOD], 12, "scan: .* above the full scale 4095 of 12 bits"),
    ],
)
def test_frames_that_are_not_the_plans_are_refused(frames, bits, message):
    with pytest.raises(DataError, match=message):
        decode(Recording(frames, X3, SIZE, bits, name="scan"))


def test_plans_that_do_not_fit_are_refused():
    plan = make_plan(("x", 8, 12), ("x", 64, 24))
    with pytest.raises(ConfigError, match="scan: 'fringes' along x have 8, 64 stripes"):
        decode(Recording(GOOD, plan, SIZE, name="scan"))
    with pytest.raises(
        ConfigError, match=r"scan: 'fringes\[2\].stripes' is 64: more than half .* 100 pixels"
    ):
        decode(Recording(GOOD, X3, (100, 100), name="scan"))


def test_what_is_saved_is_loaded(tmp_path):
    decoded = decode(Recording(GOOD, X3, SIZE))
    decoded.save(tmp_path / "x.npz")
    loaded = Decoded.load(tmp_path / "x.npz")
    for name in ("u", "v", "modulation", "sigma"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(decoded, name))
    assert [p.name for p in tmp_path.iterdir()] == ["x.npz"]


def test_what_is_no_decoded_measurement_is_refused(tmp_path):
    path = tmp_path / "x.npz"
    with pytest.raises(DataError, match="there is no such file"):
        Decoded.load(path)
    maps = {name: np.zeros((2, 3), np.float32) for name in ("u", "v", "modulation", "sigma")}
    maps["v_per_u"] = np.float64(1)
    np.savez(path, u=maps["u"])
    with pytest.raises(DataError, match="no decoded measurement"):
        Decoded.load(path)
    np.savez(path, **maps | {"v": np.zeros((3, 3), np.float32)})
    with pytest.raises(DataError, match="one size"):
        Decoded.load(path)
    np.savez(path, **maps)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(DataError, match="damaged"):
        Decoded.load(path)
    path.write_bytes(b"no archive at all")
    with pytest.raises(DataError, match="damaged"):
        Decoded.load(path)


def test_the_axis_of_x_comes_before_y():
    plan = make_plan(("y", 1, 3), ("y", 10, 3), ("x", 1, 3), ("x", 64, 3))
    assert axis_length(SIZE, "x") == SIZE[0]
    levels = render(plan)
    for level in levels[6:]:
        level[:] = 0.5 + (level - 0.5) / 2
    decoded = decode(Recording(record(levels, 16), plan, SIZE, bits=16))
    inner = decoded.valid
    np.testing.assert_allclose(decoded.modulation[inner], 0.2 * FULL16 / 256, rtol=1e-3)
