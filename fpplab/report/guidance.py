"""Section of the report on a guided characterisation: its poses in their order."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from fpplab.core.drawing import ACCENT, FULL, INK, SECOND, as_png, new_figure
from fpplab.report.parts import ReportFigure, ReportSection, ReportTable
from fpplab.report.wording import NOT_KNOWN
from fpplab.setup.guide import GuidedRun, PoseAttempt

COLUMNS = ("Pose", "Asked for", "Camera in px", "Projector in px", "Form in µm", "Outcome")
CAPTION = (
    "RMS residuals of each pose in the fit with the poses before it, and in brackets what those predict. "
    "Form: standard uncertainty of form by the calibration after the pose, root mean square over the working "
    "volume, without the board's scale."
)
FIGURE = (
    "Left: standard uncertainty of form after each pose that counts, and that asked for. Right: RMS "
    "residuals of each pose taken (bars) and those predicted by the poses before it (lines); rejected poses "
    "are hatched."
)


def guided_section(run: GuidedRun) -> ReportSection:
    rows = tuple(_attempt_row(k, attempt) for k, attempt in enumerate(run.attempts, 1))
    picture = ReportFigure.of(sequence_figure(run), "Uncertainty and residuals by pose", FIGURE, wide=True)
    text = run.sentence[0].upper() + run.sentence[1:] + "."
    return ReportSection(
        "Sequence of poses", text, (ReportTable(COLUMNS, rows, CAPTION, has_sentences=True),), (picture,)
    )


@as_png
def sequence_figure(run: GuidedRun) -> Figure:
    figure = new_figure(FULL, 3.4)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.2))
    _draw_form_uncertainty(figure.add_subplot(grid[:, 0]), run)
    _draw_residuals(figure.add_subplot(grid[0, 1]), run.attempts, "camera")
    _draw_residuals(figure.add_subplot(grid[1, 1]), run.attempts, "projector")
    return figure


def _draw_form_uncertainty(axes: Axes, run: GuidedRun) -> None:
    forms = [
        (k, 1e3 * attempt.form_mm) for k, attempt in enumerate(run.attempts, 1) if attempt.form_mm is not None
    ]
    axes.plot(*np.array(forms).reshape(-1, 2).T, "o-", color=ACCENT, markersize=4)
    if run.until_mm is not None:
        axes.axhline(1e3 * run.until_mm, color=SECOND, linewidth=1.2, linestyle="--")
        axes.annotate("asked for", (1.0, 1e3 * run.until_mm), xytext=(-4, 3), textcoords="offset points",
                      xycoords=("axes fraction", "data"), ha="right", fontsize=7.5, color=SECOND)  # fmt: skip
    axes.set(
        yscale="log", xlabel="pose", ylabel="uncertainty of form in µm", xlim=(0.4, len(run.attempts) + 0.6)
    )
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(ScalarFormatter())
    axes.tick_params(axis="y", which="minor", labelsize=6.5)


def _draw_residuals(axes: Axes, attempts: Sequence[PoseAttempt], device: str) -> None:
    for k, attempt in enumerate(attempts, 1):
        look = {"color": ACCENT} if attempt.accepted else {"color": SECOND, "hatch": "///", "fill": False}
        axes.bar(k, attempt.rms_px.get(device, 0.0), width=0.7, **look)
        if attempt.fit is not None:
            axes.hlines(
                getattr(attempt.fit, device).predicted_px, k - 0.42, k + 0.42, color=INK, linewidth=1.6
            )
    axes.set(ylabel=f"{device} in px", xlim=(0.4, len(attempts) + 0.6))
    axes.set_xticks(range(1, len(attempts) + 1))
    if device == "projector":
        axes.set_xlabel("pose")


def _attempt_row(number: int, attempt: PoseAttempt) -> tuple[str, ...]:
    cells = []
    for device in ("camera", "projector"):
        expected = f" ({getattr(attempt.fit, device).predicted_px:.3f})" if attempt.fit else ""
        cells.append(f"{attempt.rms_px[device]:.3f}{expected}" if device in attempt.rms_px else NOT_KNOWN)
    form = f"{1e3 * attempt.form_mm:.3g}" if attempt.form_mm is not None else NOT_KNOWN
    sentences = "; ".join(finding.sentence for finding in attempt.findings)
    outcome = "accepted" if attempt.accepted else f"rejected: {sentences}; {attempt.findings[0].remedy}"
    if attempt.accepted and sentences:
        outcome += f", as the pose before it: {sentences}"
    return (f"{number}: {attempt.name}", attempt.request, *cells, form, outcome)
