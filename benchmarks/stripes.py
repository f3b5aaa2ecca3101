"""The error of a measurement over the finest set's stripes, on twin and hidden bench, beside a formula.

What limits a fringe set of S stripes is the noise of its images and the ripple that the projector's lattice
leaves in its phase. With f = S / W periods per projector column, W columns, and the modulation M(f) with
which optics show a wave of frequency f, the error of the projector coordinate is

    sqrt(σ² / Σ (S M(f))² + (ripple(f) / f)²)

where σ, the same for all S, is taken from the measurement with fewest stripes, and the sum is over the sets
of the plan, all of as many images: each has its share in the coordinate. The images of a fringe in the
lattice are waves of the frequencies f + k; their phase error is the ripple. So the best S is where M(f) S
is greatest, if the ripple is weaker there than the noise. The formula knows mirrors, lens and camera pixels
from the rig's world, and nothing of how the twin computes its images.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks import Result
from fpplab.calibration.model import Calibration
from fpplab.cli import console
from fpplab.core.config import find_config
from fpplab.core.conventions import TWO_PI, Floats, Lattice
from fpplab.devices.rig import Rig
from fpplab.optimisation.arrangement import with_calibrations
from fpplab.optimisation.candidate import Candidate
from fpplab.optimisation.measuring import RigEvaluator
from fpplab.optimisation.study import Study
from fpplab.patterns.fringe_sets import stepped_fringes
from sim.world import World

STRIPES = (32.0, 64.0, 100.0, 137.0, 167.2, 200.0, 228.0)
COARSE = (1.0, 12.0)
"""Stripes of the sets that unwrap the finest."""
STEPS = 12
RIGS = ("matched_still", "hidden")
SEEDS = (101, 102)
DEPTH_MM = 448.0
IMAGES_OF_FRINGE = [image for image in product((-1, 0, 1), repeat=2) if image != (0, 0)]
"""Those beyond are weaker by orders of magnitude."""
AGREEMENT = 0.1
"""Greatest deviation of the measured error from the formula, as a share of it."""


@dataclass(frozen=True)
class Optics:
    """What shows fringes: mirrors, the projector's lens, the camera's pixels."""

    columns: int  # of the projector
    lattice: Lattice  # of its mirrors
    blur: float  # standard deviation of the point spread in mirrors, the defocus in it
    fill: float  # side of a mirror, in mirrors
    pixel: float  # side of a camera pixel in columns of the projector
    um_per_column: float  # depth of one column, in µm

    @classmethod
    def of(cls, world: World, calibration: Calibration, fill: float) -> Optics:
        """Work out the optics at the middle of the field."""
        width, height = calibration.camera.size
        pixels = np.array([[width / 2, height / 2], [width / 2 + 1, height / 2], [width / 2, height / 2]])
        depths = DEPTH_MM + np.array([[0.0], [0.0], [1.0]])
        rays = np.concatenate([calibration.camera.normalise(pixels), np.ones((3, 1))], axis=-1)
        seen = calibration.T_projector_camera.apply(rays * depths)
        u = calibration.projector.project(seen)[:, 0]
        projector = world.projector
        circle = abs(1.0 / seen[0, 2] - 1.0 / (projector.focus_mm or seen[0, 2])) * projector.aperture_mm
        mirrors = calibration.projector.matrix[0, 0] * circle * mirrors_per_column(projector.lattice)
        blur = float(np.hypot(projector.blur, mirrors / 4))  # a disc has a sixteenth of its diameter squared
        return cls(projector.size[0], projector.lattice, blur, fill, abs(u[1] - u[0]), 1e3 / abs(u[2] - u[0]))

    def modulation(self, stripes: float, image: tuple[int, int] = (0, 0)) -> float:
        """Compute by how much a fringe, or one of its images in the lattice, is weakened."""
        fringe = np.array([stripes / self.columns, 0.0])
        if self.lattice is Lattice.DIAMOND:  # its axes are at 45° to the columns, which are √2 mirrors apart
            wave = np.full(2, fringe[0] / 2) + image
            along = wave[0] + wave[1]
        else:
            wave = fringe + image
            along = wave[0]
        optics = np.sinc(self.fill * wave) * np.exp(-2 * (np.pi * self.blur * wave) ** 2)
        return float(np.prod(optics) * np.sinc(self.pixel * along))

    def ripple_columns(self, stripes: float) -> float:
        """Compute the error that the images in the lattice cause, root mean square in columns."""
        # An image and its opposite turn the phase against each other; every pair is met twice.
        pairs = [
            self.modulation(stripes, (k, m)) - self.modulation(stripes, (-k, -m)) for k, m in IMAGES_OF_FRINGE
        ]
        phase = np.sqrt(np.sum(np.square(pairs)) / 4) / self.modulation(stripes)
        return float(phase * self.columns / stripes / TWO_PI)

    def errors_um(self, stripes: Floats, noise: float) -> Floats:
        """Evaluate the formula."""
        coarse = sum((s * self.modulation(s)) ** 2 for s in COARSE)
        noises = [noise / np.sqrt(coarse + (s * self.modulation(s)) ** 2) for s in stripes]
        return self.um_per_column * np.hypot(noises, [self.ripple_columns(s) for s in stripes])


def mirrors_per_column(lattice: Lattice) -> float:
    """Give the distance of two columns in mirrors."""
    return float(np.sqrt(2.0)) if lattice is Lattice.DIAMOND else 1.0


def run() -> list[Result]:
    """Measure; a quarter of an hour on two cores."""
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        return [result for name in RIGS for result in stripe_figures(name, Path(folder))]


def stripe_figures(name: str, folder: Path) -> list[Result]:
    """Measure on one rig."""
    file = f"rig_{name}.yaml"
    with Rig.load(file) as rig, console.progress(f"Characterising {name}") as report:
        study = with_calibrations(rig, Study.load("study_stripes.yaml"), folder / name, report)
        assert rig.file.bench is not None
        world = World.load(find_config(str(rig.file.bench.options["world"])))
    evaluator = RigEvaluator(file, study)
    try:
        measured = np.array([_measured_um(evaluator, study, stripes) for stripes in STRIPES])
        optics = Optics.of(world, evaluator.calibrations.at(), world.projector.fill_factor**0.5)
    finally:
        evaluator.close()
    noise = measured[0] / optics.errors_um(np.array(STRIPES[:1]), 1.0)[0]
    expected = optics.errors_um(np.array(STRIPES), noise)
    errors = [
        Result(f"stripes_{name}_{s:g}", m, "um", e, AGREEMENT / max(abs(m / e - 1), 1e-3))
        for s, m, e in zip(STRIPES, measured, expected, strict=True)
    ]
    best, theirs = (STRIPES[int(np.argmin(one))] for one in (measured, expected))
    agreement = min(best, theirs) / max(best, theirs)
    return [*errors, Result(f"stripes_{name}_best", best, "stripes", theirs, agreement)]


def _measured_um(evaluator: RigEvaluator, study: Study, stripes: float) -> float:
    """Root mean square distance of points from the true surface, with a finest set of twelve images."""
    sets = tuple(stepped_fringes("x", each, STEPS) for each in (*COARSE, stripes))
    candidate = Candidate(sets, study.start.exposure_s)
    scores = [score for seed in SEEDS for score in evaluator.measure(candidate, seed)]
    return float(np.sqrt(np.mean([score.surface_rms_um**2 for score in scores])))
