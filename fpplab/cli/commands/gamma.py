"""`fpplab gamma`: fit the response of projector and camera."""

from typing import Annotated, Any

import typer

from fpplab.cli import console
from fpplab.cli.app import PREPARE, Force, Json, Out, PlanName, RigName, app
from fpplab.cli.completion import option
from fpplab.cli.viewing import KeepOpen, ResponseObserver, ViewOption, make_observer


@app.command("gamma", rich_help_panel=PREPARE)
def gamma_command(
    context: typer.Context,
    rig: RigName,
    out: Out,
    plan: PlanName = "plan_paper.yaml",
    levels: Annotated[
        int | None, option("--levels", "Number of grey levels to show. Default: the plan's.", min=5, max=256)
    ] = None,
    repeats: Annotated[
        int | None, option("--repeats", "Number of repeats. Default: the plan's.", min=1, max=1000)
    ] = None,
    exposure_s: Annotated[float | None, option("--exposure", "Exposure in s. Default: the plan's.")] = None,
    item: Annotated[str, option("--item", "Item in view: an evenly white card.")] = "grey_card",
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Measure the response (gamma) of projector and camera.

    The response is `I_out = a I_in^g + b` of both together. Projects uniform grey levels, says whether the
    response is good enough for the plan, and writes OUT with a picture and a report next to it. A plan with
    the line `response: OUT` corrects its patterns by it.

    Example: `fpplab gamma --rig rig_demo --plan plan_paper --levels 24 --repeats 4 --out response.yaml`
    """
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.workflows.gamma import GammaRequest, check_gamma_output, run_gamma

    request = GammaRequest(
        rig=Rig.load(rig),
        plan=Plan.load(plan),
        out=out,
        levels=levels,
        repeats=repeats,
        exposure_s=exposure_s,
        item=item,
        force=force,
    )
    check_gamma_output(request)
    observer = make_observer(context, ResponseObserver, view, keep_open, out.with_suffix(".rrd"))
    result = run_gamma(request, observer).summary()
    console.print_result(result, json, lambda: _show_response(result))


def _show_response(result: dict[str, Any]) -> None:
    for name, sigma in zip("abg", result["sigma"], strict=True):
        console.stdout.print(f"{name} = {result[name]:.5f} ± {sigma:.2g}")
    if result["spline"]:
        console.stdout.print(
            f"no power law predicts the levels: a spline of {len(result['spline'])} coefficients is used, g "
            "is for information"
        )
    fitted, regions, spread = len(result["levels"]), len(result["regions"]), result["region_spread"]
    agree = f"; {regions} regions agree on g to {spread:.2g}" if spread is not None else ""
    console.stdout.print(f"RMS misfit {result['residual']:.2g} of full scale, {fitted} levels{agree}")
    console.stdout.print(result["judgement"]["sentence"], markup=False, soft_wrap=True)
    console.stdout.print(f"picture: {result['picture']}")
    console.stdout.print(f"report: {result['report']}")
