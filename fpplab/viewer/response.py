"""A measurement of the response as it goes: the uniform images, the levels seen, and the fit."""

from matplotlib.figure import Figure as Sheet

from fpplab.core.drawing import ACCENT, FULL, as_png, single_axes
from fpplab.patterns.response import Response
from fpplab.report.response_figures import response_fit
from fpplab.viewer import layouts
from fpplab.viewer.canvas import CommandView, eight_bits
from fpplab.viewer.measurement import ShownFrame


class ResponseView(CommandView):
    """The camera's image on the left, levels and fit on the right; the timeline is `frame`."""

    def arrange_views(self) -> None:
        import rerun.blueprint as rrb

        self._levels: list[tuple[float, float]] = []
        right = rrb.Vertical(
            layouts.image("Levels seen", "/diagrams/levels"),
            layouts.image("Response", "/diagrams/response"),
            layouts.text_view("Fit", "/words/fit"),
            row_shares=[3, 3, 1],
        )
        self.canvas.arrange(rrb.Horizontal(layouts.image("Camera", "/images/camera"), right))

    def frame(self, level: int, frame: ShownFrame) -> None:
        full = (1 << frame.bits) - 1
        self.canvas.at("frame", len(self._levels))
        self._levels.append((float(level), float(frame.image.mean()) / full))
        self.canvas.picture("images/camera", eight_bits(frame.image, frame.bits))
        self.canvas.figure("diagrams/levels", levels_so_far(self._levels))

    def response(self, response: Response) -> None:
        self.canvas.figure("diagrams/response", response_fit(response), static=True)
        coefficients = response.summary()
        self.canvas.text(
            "words/fit",
            "I_out = a I_in^g + b: " + ", ".join(f"{name} = {coefficients[name]:.5f}" for name in "abg"),
        )


@as_png
def levels_so_far(levels: list[tuple[float, float]]) -> Sheet:
    figure, axes = single_axes(FULL, 3.4)
    axes.plot(*zip(*levels, strict=True), "o", color=ACCENT, markersize=4)
    axes.set(xlabel="grey level shown, of 255", ylabel="mean level seen, of full scale", xlim=(-5, 260))
    return figure
