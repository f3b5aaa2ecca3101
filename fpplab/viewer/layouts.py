"""Arrangements of views that several commands share."""

from collections.abc import Mapping, Sequence
from typing import Any

from fpplab.viewer.canvas import BACKGROUND


def image(name: str, origin: str) -> Any:
    import rerun.blueprint as rrb

    return rrb.Spatial2DView(origin=origin, name=name, background=BACKGROUND)


def scene(name: str, contents: Sequence[str]) -> Any:
    import rerun.blueprint as rrb

    return rrb.Spatial3DView(
        origin="/world",
        contents=list(contents),
        name=name,
        background=BACKGROUND,
        line_grid=rrb.archetypes.LineGrid3D(visible=False),
    )


def with_bar(content: Any, bar: str, name: str) -> Any:
    import rerun.blueprint as rrb

    return rrb.Vertical(content, image("Colours", bar), row_shares=[10, 1], name=name)


def curves(name: str, contents: Mapping[str, Sequence[str]] | Sequence[str]) -> Any:
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(origin="/", contents=list(contents), name=name)


def text_view(name: str, origin: str) -> Any:
    import rerun.blueprint as rrb

    return rrb.TextDocumentView(origin=origin, name=name)
