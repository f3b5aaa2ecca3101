"""A search as it goes: all candidates with their front and optimum, and the best by epoch."""

from collections.abc import Sequence

from matplotlib.figure import Figure as Sheet

from fpplab.core.drawing import ACCENT, ALARM, FULL, SECOND, as_png, single_axes
from fpplab.optimisation.candidate import CandidateFigures, MeasuredCandidate
from fpplab.optimisation.candidate_runner import SearchEpoch
from fpplab.viewer import layouts
from fpplab.viewer.canvas import CommandView

CURVES = {
    "surface_smcd_um": "mean distance to the surface in µm",
    "images": "images",
    "completeness": "completeness",
    "wrong_orders": "share of wrong orders",
}


class SearchView(CommandView):
    """The front on the left, the optimum and curves on the right; the timeline is `epoch`."""

    def arrange_views(self) -> None:
        import rerun.blueprint as rrb

        self._measured: list[MeasuredCandidate] = []
        for key, name in CURVES.items():
            self.canvas.curve_style(f"search/{key}", f"best: {name}", (51, 120, 184))
        curves = [
            layouts.curves(f"{name[:1].upper()}{name[1:]}", [f"/search/{key}"])
            for key, name in CURVES.items()
        ]
        left = rrb.Vertical(
            layouts.image("Candidates, front and optimum", "/diagrams/front"),
            layouts.text_view("Optimum and front", "/words/optimum"),
            row_shares=[3, 2],
        )
        self.canvas.arrange(rrb.Horizontal(left, rrb.Vertical(*curves), column_shares=[5, 4]))

    def epoch(self, epoch: SearchEpoch) -> None:
        self._measured += [trial for trial in epoch.trials if trial.measured]
        self.canvas.at("epoch", epoch.number)
        for key in CURVES:
            self.canvas.value(f"search/{key}", float(getattr(epoch.best.figures, key)))
        self.canvas.figure("diagrams/front", front_so_far(self._measured, epoch.front, epoch.best))
        listed = [
            ("optimum", epoch.best),
            *((f"front {k}", candidate) for k, candidate in enumerate(epoch.front, 1)),
        ]
        rows = "\n".join(_candidate_row(name, candidate) for name, candidate in listed)
        self.canvas.text(
            "words/optimum",
            f"**Epoch {epoch.number}**, {epoch.step}: {epoch.measured} candidates measured\n\n"
            "| plan | images | stripes | steps | stage mm | distance µm | completeness |\n"
            f"|---|---|---|---|---|---|---|\n{rows}",
            static=False,
        )


def _candidate_row(name: str, trial: MeasuredCandidate) -> str:
    figures, candidate = trial.figures, trial.candidate
    cells = (
        name,
        str(figures.images),
        " ".join(each.short_name for each in candidate.fringes),
        " ".join(str(each.images) for each in candidate.fringes),
        "" if candidate.stage_mm is None else f"{candidate.stage_mm:g}",
        f"{figures.surface_smcd_um:.2f}",
        f"{figures.completeness:.3f}",
    )
    return f"| {' | '.join(cells)} |"


@as_png
def front_so_far(
    measured: Sequence[MeasuredCandidate], front: Sequence[MeasuredCandidate], best: MeasuredCandidate
) -> Sheet:
    def places(trials: Sequence[MeasuredCandidate]) -> tuple[list[int], list[float]]:
        figures: list[CandidateFigures] = [trial.figures for trial in trials]
        return [f.images for f in figures], [f.surface_smcd_um for f in figures]

    figure, axes = single_axes(FULL, 4.0)
    axes.plot(*places(measured), "o", color="#9aa1a9", markersize=3.5, label="candidates")
    ordered = sorted(front, key=lambda trial: trial.figures.images)
    axes.plot(*places(ordered), "o-", color=ACCENT, markersize=5, linewidth=1.2, label="front")
    axes.plot(*places([best]), "*", color=ALARM, markersize=13, label="optimum")
    axes.plot(*places(measured[:1]), "s", color=SECOND, markersize=6, label="start")
    axes.set(xlabel="images", ylabel="mean distance to the surface in µm")
    axes.legend(loc="upper right")
    return figure
