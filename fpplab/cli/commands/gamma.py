"""`fpplab gamma`: fit the response of projector and camera."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from fpplab.cli import console
from fpplab.cli.app import PREPARE, Force, Json, Out, PlanName, RigName, app
from fpplab.cli.viewing import KeepOpen, ViewOption, open_viewer
from fpplab.core.errors import ConfigError


@app.command("gamma", rich_help_panel=PREPARE)
def gamma_command(
    context: typer.Context,
    rig: RigName,
    out: Out,
    plan: PlanName = "plan_paper.yaml",
    levels: Annotated[
        int | None,
        typer.Option("--levels", min=5, max=256, help="Grey levels to show; the plan's by default."),
    ] = None,
    repeats: Annotated[
        int | None, typer.Option("--repeats", min=1, max=1000, help="How often; the plan's by default.")
    ] = None,
    exposure_s: Annotated[
        float | None, typer.Option("--exposure", help="Exposure in s; the plan's by default.")
    ] = None,
    item: Annotated[str, typer.Option("--item", help="What to look at: an evenly white card.")] = "grey_card",
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Fit the response `I_out = a I_in^g + b` of projector and camera together.

    Shows uniform grey-level images, says whether the response is good enough for the plan, and writes OUT, a
    picture and a report beside it. The line `response: OUT` in a plan has its patterns corrected with it.

    Example: `fpplab gamma --rig rig_demo --plan plan_paper --levels 24 --repeats 4 --out response.yaml`
    """
    from fpplab.core.files import refuse_existing, write_atomic
    from fpplab.devices.rig import Rig
    from fpplab.patterns.phase_error import judge_response
    from fpplab.patterns.plan import GreyLevels, Plan
    from fpplab.pipeline import measure_response
    from fpplab.report import is_report
    from fpplab.results.provenance import described_rig, rig_provenance
    from fpplab.viewer.measurement import ShownFrame
    from fpplab.viewer.response import ResponseView

    picture, page = out.with_suffix(".png"), out.with_suffix(".html")
    if out in (picture, page):
        what = "picture" if out == picture else "report"
        raise ConfigError(f"{out}: is the name of the {what}; name it otherwise, such as .yaml")
    refuse_existing(out, force)
    for path in (picture, page):
        refuse_existing(path, force or is_report(page))  # of a run that ended before its result
    wanted = Plan.load(plan)
    greys = GreyLevels(levels=levels or wanted.greys.levels, repeats=repeats or wanted.greys.repeats)
    viewer = open_viewer(context, ResponseView, view, keep_open, out.with_suffix(".rrd"))
    with Rig.load(rig) as bench, console.progress("Response") as report:
        if bench.fixture:
            bench.fixture.mount(item)
        exposure = wanted.exposure_s if exposure_s is None else exposure_s
        response, seen = measure_response(
            *(bench, exposure, greys, report),
            observe_frame=lambda level, frame: viewer.show_one_of_many(
                ResponseView.frame, level, ShownFrame.of(frame)
            ),
        )
        judgement = judge_response(response, wanted, bench.projector.caps.size)
        described = described_rig(bench)

    from fpplab.report.gamma_page import write_gamma_report
    from fpplab.report.response_figures import response_fit

    for reason in response.left_out:
        console.log_status(f"left out: {reason}")
    viewer.show(ResponseView.response, response)
    drawn = response_fit(response)
    source = rig_provenance(*described, wanted, exposure_s=exposure).with_values(item=item, response=out.name)
    answer = {**response.summary(), "judgement": judgement.model_dump(mode="json")}
    write_gamma_report(page, response, seen, judgement, source, answer)
    write_atomic(picture, lambda stream: stream.write(drawn))
    response.save(out)  # last: where it is, all is done
    result = {
        **answer,
        "provenance": source.summary(),
        "response": str(out),
        "picture": str(picture),
        "report": str(page),
    }
    console.print_result(result, json, lambda: _show_response(result))


def _show_response(result: dict[str, Any]) -> None:
    for name, sigma in zip("abg", result["sigma"], strict=True):
        console.stdout.print(f"{name} = {result[name]:.5f} ± {sigma:.2g}", markup=False)
    if result["spline"]:
        console.stdout.print(
            f"no power law predicts the levels: a spline of {len(result['spline'])} coefficients is used, g "
            "is for information"
        )
    fitted, regions, spread = len(result["levels"]), len(result["regions"]), result["region_spread"]
    agree = f"; {regions} regions agree on g to {spread:.2g}" if spread is not None else ""
    console.stdout.print(f"RMS misfit {result['residual']:.2g} of full scale, {fitted} levels{agree}")
    console.stdout.print(result["judgement"]["sentence"], markup=False, soft_wrap=True)
    console.stdout.print(f"picture: {result['picture']}", markup=False)
    console.stdout.print(f"report: {result['report']}", markup=False)
