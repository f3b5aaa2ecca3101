"""A projector whose response has the form of an S: the phase error that is stated, and what is left of it.

The response is measured on a simulated bench, with its noise and rounding. The truth is decoded from the
light of the true curve, without noise, for the patterns that the plan makes.
"""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks import Result, above, below
from benchmarks.hidden.bench import write_rig
from benchmarks.hidden.worlds import CARD, drawn_world
from benchmarks.outside import s_shaped
from fpplab.core.conventions import TWO_PI, Lattice
from fpplab.devices.rig import Rig
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.phase_error import judge_response, shown_phase_error
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response
from fpplab.phase import wrapped_phase
from fpplab.pipeline.response import measure_response

SEED = 6100
SIZE, STRIPES = (4096, 8), 7.3
"""Of the patterns, whose stripes are many pixels wide at every phase."""
STEPS = range(3, 13)
NEAR = 0.25
"""Relative difference between stated and true phase error."""
FINE = 1 << 24
"""Grey levels of patterns without rounding, of which a projector with 256 leaves more than the correction."""
SMALLER = 10.0
"""By how much correction lessens the phase error."""


def run() -> list[Result]:
    """Measure statements on a response in the form of an S; the baselines are the targets."""
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        world = s_shaped(drawn_world(SEED, 1, 8))
        with Rig.load(write_rig(world, Path(folder), "Bench with a bent response")) as rig:
            rig.need_fixture("the benchmark").mount(CARD, 0)
            measured = measure_response(rig, 0.02)[0]
        return response_figures(measured, world.projector.response)


def response_figures(measured: Response, true: Curve) -> list[Result]:
    """Compare what is stated with the truth."""
    results = []
    for steps in STEPS:
        plan = Plan(fringes=(Sinusoid(axis="x", stripes=STRIPES, steps=steps),))
        stated = judge_response(measured, plan, SIZE).phase_rad
        curve = Curve(a=measured.a, b=measured.b, g=measured.g, spline=measured.spline)
        corrected = plan.model_copy(update={"response": curve})
        before, after = (decoded_error(one, true) for one in (plan, corrected))
        by_curve = shown_phase_error(true, steps, curve, greys=FINE)
        results += [
            below(f"bent_response_{steps}_steps_stated_off", abs(stated / before - 1.0), "relative", NEAR),
            above(f"bent_response_{steps}_steps_corrected", before / after, "times", SMALLER),
            above(f"bent_response_{steps}_steps_corrected_unrounded", before / by_curve, "times", SMALLER),
        ]
    return results


def decoded_error(plan: Plan, true: Curve) -> float:
    """Decode a plan's patterns as the true response shows them."""
    patterns = make_patterns(plan, SIZE, Lattice.SQUARE)
    light = [true.apply(one.image[:1] / 255.0) for one in patterns]
    frames = [np.rint(60_000 * one + 1_000).astype(np.uint16) for one in light]
    found = wrapped_phase(frames, plan.fringes[0]).phase[0]
    phase = TWO_PI * STRIPES * (np.arange(SIZE[0]) + 0.5) / SIZE[0]
    error = np.angle(np.exp(1j * (found - phase)))
    error = np.angle(np.exp(1j * (error - np.angle(np.mean(np.exp(1j * error))))))
    return float(np.sqrt(np.mean(error**2)))
