"""The same captures through fpplab, through plain NumPy and through Fringes, and the rate SLStudio publishes.

    python -m benchmarks strangers

A pyramid whose truth is known (as `fpplab sample` writes it) shows the error of each decoder. Captures of
SLStudio's own rig (`skull_2x3` in the folder that FPPLAB_DATA names) show what each makes of real images,
beside a Gray code of the same part. Fringes (GPL-3.0) is no dependency; it is used where `pip install
fringes` has installed it. All programs get the same limit of modulation. Times are processor times of one
thread, the first call left out.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numba
import numpy as np

from benchmarks import Result, above
from benchmarks.real_captures import captures
from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Floats, Mask
from fpplab.core.errors import ConfigError
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.reconstruction.points import triangulate
from fpplab.sessions.image_selection import ImageSelection
from fpplab.sessions.importing import import_images
from fpplab.sessions.session import Session
from fpplab.workflows.sample import SampleRequest, make_sample
from sim.world import World

SLSTUDIO_HZ = 20.0  # depth images per second (Wilm, Olesen, Larsen 2014, of their own computer)
GRAY_CELL_PX = 2.0  # of SLStudio's Gray code: 10 bits over 1824 columns
REPEATS = 5

Coordinates = tuple[Floats, Mask]  # projector columns (height, width), and where they were measured
Decoder = Callable[[Recording], Coordinates]


def with_fpplab(recording: Recording) -> Coordinates:
    decoded = decode(recording)
    return np.asarray(decoded.u, np.float64), decoded.valid


def with_numpy(recording: Recording) -> Coordinates:
    """Decode as textbooks do: arctangent, then hierarchical unwrapping from the coarsest set on."""
    plan, width = recording.plan, recording.projector_size[0]
    absolute, previous = None, 1.0
    for index, fringe in _sinusoids(plan):
        images = np.asarray(recording.of_set(index), np.float64)
        shifts = 2 * np.pi * np.arange(len(images)) / len(images)
        sine, cosine = (np.tensordot(f(shifts), images, 1) for f in (np.sin, np.cos))
        phase = (np.arctan2(sine, cosine) - fringe.phase_origin_rad) % (2 * np.pi)
        if absolute is not None:
            phase += 2 * np.pi * np.round((absolute * fringe.stripes / previous - phase) / (2 * np.pi))
        absolute, previous = phase, fringe.stripes
    modulation = 2 / len(images) * np.hypot(sine, cosine)
    assert absolute is not None
    return absolute * width / (2 * np.pi * previous) - 0.5, modulation >= plan.masks.modulation_min


def with_fringes(recording: Recording) -> Coordinates:
    """Decode with the package Fringes, whose first pixel begins at 0 and not at -0.5."""
    from fringes import Fringes  # type: ignore[import-not-found,unused-ignore]

    plan, settings = recording.plan, Fringes()
    chosen = _sinusoids(plan)
    settings.X, settings.Y = recording.projector_size
    settings.axes, settings.K, settings.p0 = 1, len(chosen), 0.0
    settings.v = [fringe.stripes for _, fringe in chosen]
    settings.N = [fringe.images for _, fringe in chosen]
    images = np.concatenate([np.asarray(recording.of_set(k)) for k, _ in chosen])[..., None]
    _, modulation, coordinate = settings.decode(images, threads=1)
    finest = chosen[-1][1]
    origin_px = finest.phase_origin_rad * recording.projector_size[0] / (2 * np.pi * finest.stripes)
    column = coordinate[0, ..., 0] - origin_px - 0.5
    return column, modulation[-1, ..., 0] >= plan.masks.modulation_min


def _sinusoids(plan: Plan) -> list[tuple[int, Sinusoid]]:
    """Give the sets along x with their indices, the coarsest first."""
    sets = [
        (k, each) for k, each in enumerate(plan.fringes) if isinstance(each, Sinusoid) and each.axis == "x"
    ]
    return sorted(sets, key=lambda numbered: numbered[1].stripes)


def others() -> dict[str, Decoder]:
    """Give the decoders that are installed beside fpplab's own."""
    decoders: dict[str, Decoder] = {"NumPy": with_numpy}
    try:
        import fringes  # noqa: F401
    except ImportError:
        print("left out: Fringes, which is not installed")
        return decoders
    return {**decoders, "Fringes": with_fringes}


def run(sample: Path | None = None) -> list[Result]:
    """Compare on the sample, and on SLStudio's captures; two minutes."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        if sample is None:
            make_sample(SampleRequest(sample := folder / "sample"))
        results = [*_on_known_truth(sample)]
        try:
            results += _on_captures(captures(), folder)
        except ConfigError as error:
            print(f"left out: {error}")
    return results


def _on_known_truth(sample: Path) -> Iterator[Result]:
    recording = Session.open(sample / "pyramid").recording()
    with np.load(sample / "truth" / "pyramid.npz") as truth:
        expected, lit = truth["u"].astype(np.float64), truth["mask"]
    period_px = 912 / 64
    ours = _errors(*with_fpplab(recording), expected, lit, period_px)
    for name, decoder in others().items():
        theirs = _errors(*decoder(recording), expected, lit, period_px)
        for label, unit, mine, other in zip(
            ("error of u, RMS", "wrong orders", "left out"), ("px", "%", "%"), ours, theirs, strict=True
        ):
            yield Result(f"pyramid, {label}, {name}", mine, unit, other, (other + 1e-9) / (mine + 1e-9))
        yield _times("pyramid", recording, name, decoder)


def _errors(u: Floats, valid: Mask, expected: Floats, lit: Mask, period_px: float) -> tuple[float, ...]:
    """RMS without wrong orders in px, then percentages of wrong orders and of lit pixels left out."""
    error = (u - expected)[valid & lit]
    wrong = np.abs(error) > period_px / 2
    return (
        float(np.sqrt(np.mean(error[~wrong] ** 2))),
        100 * float(wrong.mean()),
        100 * float(1 - (valid & lit).sum() / lit.sum()),
    )


def _on_captures(data: Path, folder: Path) -> Iterator[Result]:
    plan = Plan.load("plan_slstudio_skull")
    import_images(ImageSelection((data / "skull_2x3",), "{index:02d}.png"), plan, folder / "skull")
    recording = Session.open(folder / "skull").recording()
    ours = with_fpplab(recording)
    gray = _gray_columns(data / "skull_gray")
    for name, decoder in others().items():
        theirs = decoder(recording)
        near = [
            100 * float(np.mean(np.abs(u - gray)[valid] <= 3 * GRAY_CELL_PX)) for u, valid in (ours, theirs)
        ]
        count = [int(np.sum(valid)) for _, valid in (ours, theirs)]
        yield Result(f"skull, within 6 px of the Gray code, {name}", near[0], "", near[1], near[0] / near[1])
        yield Result(f"skull, pixels measured, {name}", count[0], "px", count[1], count[0] / count[1])
        yield _times("skull", recording, name, decoder)
    world = World.load("world_slstudio.yaml")
    devices = Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(0.0), {})
    seconds = _seconds(lambda: triangulate(decode(recording), devices))
    yield above("skull, clouds from six images, SLStudio as published", 1 / seconds, "Hz", SLSTUDIO_HZ)


def _gray_columns(folder: Path) -> Floats:
    """Decode SLStudio's Gray code: white, black, then ten bits, the most significant first."""
    from PIL import Image

    images = np.stack([np.asarray(Image.open(file), np.float64) for file in sorted(folder.glob("*.png"))])
    bits = images[2:] > images[:2].mean(axis=0)
    binary = np.cumsum(bits, axis=0) % 2
    return GRAY_CELL_PX * (np.tensordot(2.0 ** np.arange(len(bits))[::-1], binary, 1) + 0.5) - 0.5


def _times(part: str, recording: Recording, name: str, decoder: Decoder) -> Result:
    ours, theirs = (_seconds(lambda run=run: run(recording)) for run in (with_fpplab, decoder))  # type: ignore[misc]
    return Result(f"{part}, time to decode, {name}", 1e3 * ours, "ms", 1e3 * theirs, theirs / ours)


def _seconds(call: Callable[[], object]) -> float:
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        call()
        taken = []
        for _ in range(REPEATS):
            begun = time.process_time()
            call()
            taken.append(time.process_time() - begun)
    finally:
        numba.set_num_threads(threads)
    return min(taken)
