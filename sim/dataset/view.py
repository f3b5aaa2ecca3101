"""A data set as it grows: frames, labels and what was drawn for each sample."""

import json
from typing import Any

import numpy as np

from fpplab.core.conventions import TWO_PI
from fpplab.viewer import layouts
from fpplab.viewer.canvas import CommandView, subsample_columns
from fpplab.viewer.colours import ColourScale
from fpplab.viewer.viewer import Viewer
from sim.dataset.making import SampleObserver
from sim.dataset.shard import FRAMES, Arrays

SHOWN = {
    "wrapped_phase": ("Wrapped phase of the finest set", "rad", "twilight"),
    "depth": ("True distance from the camera", "mm", "viridis_r"),
    "projector_u": ("True projector column u", "px", "viridis"),
    "modulation": ("Modulation", "grey levels of 255", "inferno"),
}
"""By field: quantity, unit and colours of the map."""


class SampleView(CommandView):
    """Maps of the latest sample; the timeline is `sample`."""

    def arrange_views(self) -> None:
        import rerun.blueprint as rrb

        maps = [layouts.image(title, f"/sample/{name}") for name, (title, *_) in SHOWN.items()]
        images = [
            layouts.image("Camera", "/sample/camera"),
            *maps,
            layouts.image("Normals", "/sample/normals"),
        ]
        self.canvas.arrange(
            rrb.Horizontal(
                rrb.Grid(*images, grid_columns=3),
                layouts.text_view("Scene", "/words/scene"),
                column_shares=[4, 1],
            )
        )

    def sample(self, arrays: dict[str, Any], record: dict[str, Any]) -> None:
        self.canvas.at("sample", record["index"])
        image = arrays[FRAMES].astype(np.float32)
        bright = max(float(np.percentile(image, 99.8)), 1.0)
        self.canvas.map("sample/camera", image, ColourScale("Raw level", "", "gray", 0.0, bright))
        for name in SHOWN.keys() & arrays.keys():
            title, unit, colours = SHOWN[name]
            scale = ColourScale.spanning(title, unit, colours, arrays[name])
            if name == "wrapped_phase":
                scale = ColourScale(title, unit, colours, 0.0, TWO_PI)
            self.canvas.map(f"sample/{name}", arrays[name], scale)
        normals = np.nan_to_num(arrays["normals"], nan=0.0)
        self.canvas.picture("sample/normals", (127.5 * (normals + 1.0)).astype(np.uint8))
        scene = json.dumps(record["scene"], indent=1, ensure_ascii=False)
        self.canvas.text("words/scene", f"**Sample {record['index']}**\n\n```\n{scene}\n```", static=False)


def sample_observer(viewer: Viewer[SampleView]) -> SampleObserver:
    def observe(arrays: Arrays, record: dict[str, Any]) -> None:
        shown = {name: subsample_columns(arrays[name]).copy() for name in SHOWN if name in arrays}
        if "wrapped_phase" in shown:
            shown["wrapped_phase"] = subsample_columns(arrays["wrapped_phase"][-1]).copy()
        shown["normals"] = subsample_columns(np.moveaxis(arrays["normals"], 0, -1)).copy()
        shown[FRAMES] = subsample_columns(arrays[FRAMES][-1]).copy()
        viewer.show_one_of_many(SampleView.sample, shown, record)

    return observe
