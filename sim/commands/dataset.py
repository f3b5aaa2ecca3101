"""`fpplab dataset`: labelled captures of random scenes, for machine learning."""

from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import Json, Out, PlanName, RigName
from fpplab.cli.completion import config_option, option
from fpplab.cli.viewing import KeepOpen, ViewOption, open_viewer

program = typer.Typer()


@program.command("dataset", rich_help_panel="twin")
def dataset_command(
    context: typer.Context,
    rig: RigName,
    count: Annotated[int, option("--count", "Number of samples.", min=1)],
    out: Out,
    plan: PlanName = "plan_paper.yaml",
    scenes: Annotated[
        str,
        config_option("dataset", "Scene file: ranges from which scenes are drawn.", "--scenes"),
    ] = "dataset_demo.yaml",
    seed: Annotated[int, option("--seed", "Seed of the random scenes.", min=0)] = 0,
    shard_size: Annotated[int, option("--shard-size", "Number of samples per shard.", min=1)] = 8,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    json: Json = False,
) -> None:
    """Generate labelled captures of random scenes on a simulated rig, for machine learning.

    Each sample contains the frames, wrapped phase, decoded coordinates, and the truth: absolute phase,
    depth, normals, mask, calibration, and all random parameters. OUT contains shards of NumPy files,
    `card.json` and `README.md`; `sim.dataset.Dataset(OUT)` reads it. The same command completes an
    interrupted data set; when started twice at once, the two processes share the work.

    Example: `fpplab dataset --rig rig_demo_quick --count 100 --out captures`
    """
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from sim.dataset.making import need_simulation
    from sim.dataset.scenes import SceneRanges

    wanted_plan, ranges, devices = Plan.load(plan), SceneRanges.load(scenes), Rig.load(rig)
    need_simulation(devices, rig)
    with console.stopwatch() as seconds, devices as bench:
        from fpplab.core.session_names import RECORDING
        from sim.dataset import Dataset
        from sim.dataset.making import DatasetMaker, DatasetRequest
        from sim.dataset.view import SampleView, sample_observer

        viewer = open_viewer(context, SampleView, view, keep_open, out / RECORDING)

        maker = DatasetMaker(bench, DatasetRequest(wanted_plan, ranges, count, seed, shard_size))
        with console.progress("Making samples") as report:
            card = maker.make(out, report, sample_observer(viewer))
        result = {
            "samples": len(Dataset(out)),
            "shards": card["shards"],
            "splits": card["splits"],
            "bytes": card["bytes"],
            "seconds": seconds(),
        }
    console.print_result({**result, "dataset": str(out)}, json)
