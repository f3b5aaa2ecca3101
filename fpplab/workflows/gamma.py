"""Measure the response of projector and camera, and judge it for a plan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.errors import ConfigError
from fpplab.core.files import refuse_existing, removed_on_failure, write_atomic
from fpplab.results.observer import Observer

if TYPE_CHECKING:
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.results.response import ResponseResult


@dataclass(frozen=True, eq=False)
class GammaRequest:
    """What to measure the response with, and where it goes."""

    rig: Rig  # not open
    plan: Plan  # that it is judged for
    out: Path  # the response; a picture and a report go next to it
    levels: int | None = None  # grey levels to show; the plan's by default
    repeats: int | None = None  # how often; the plan's by default
    exposure_s: float | None = None  # the plan's by default
    item: str = "grey_card"  # that the rig's fixture puts up
    force: bool = False  # whether existing files are replaced

    @property
    def picture(self) -> Path:
        return self.out.with_suffix(".png")

    @property
    def page(self) -> Path:
        return self.out.with_suffix(".html")


def run_gamma(request: GammaRequest, observer: Observer | None = None) -> ResponseResult:
    """Show uniform images, fit the response, and write it with its picture and report."""
    check_gamma_output(request)
    observer = observer or Observer()
    result = _measure_and_save(request, observer)
    for reason in result.response.left_out:
        observer.message(f"left out: {reason}")
    observer.result(result)

    from fpplab.report.response import write_response_report
    from fpplab.report.response_figures import response_fit

    picture = response_fit(result.response)
    write_response_report(request.page, result)
    with removed_on_failure(request.page), removed_on_failure(request.picture):
        write_atomic(request.picture, lambda stream: stream.write(picture))
        result.response.save(request.out)  # last: its existence means that all is done
    return result


def check_gamma_output(request: GammaRequest) -> None:
    """Refuse an output that exists already, or has the name of another."""
    from fpplab.report.page import is_report

    for path, what in ((request.picture, "picture"), (request.page, "report")):
        if request.out == path:
            raise ConfigError(
                f"{request.out}: is the name of the {what}; give it another suffix, such as .yaml"
            )
    refuse_existing(request.out, request.force)
    for path in (request.picture, request.page):
        # A report alone is of a run that ended before its result.
        refuse_existing(path, request.force or is_report(path))


def _measure_and_save(request: GammaRequest, observer: Observer) -> ResponseResult:
    from fpplab.patterns.phase_error import judge_response
    from fpplab.patterns.plan import GreyLevels
    from fpplab.pipeline.response import measure_response
    from fpplab.results.provenance import described_rig, rig_provenance
    from fpplab.results.response import GreyLevelFrame, ResponseResult

    plan = request.plan
    greys = GreyLevels(
        levels=request.levels or plan.greys.levels, repeats=request.repeats or plan.greys.repeats
    )
    exposure_s = plan.exposure_s if request.exposure_s is None else request.exposure_s
    with request.rig as rig, observer.stage("Response") as progress:
        if rig.fixture:
            rig.fixture.mount(request.item)
        response, levels = measure_response(
            rig,
            exposure_s,
            greys,
            progress,
            observe_frame=lambda level, frame: observer.result(GreyLevelFrame(level, frame)),
        )
        judgement = judge_response(response, plan, rig.projector.caps.size)
        described, origin = described_rig(rig)
    provenance = rig_provenance(described, origin, plan, exposure_s=exposure_s)
    return ResponseResult(
        response=response,
        levels=levels,
        judgement=judgement,
        provenance=provenance.with_values(item=request.item, response=request.out.name),
        response_file=request.out,
        picture_file=request.picture,
        report_file=request.page,
    )
