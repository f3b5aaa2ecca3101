"""A measurement as it grows, or a recorded one: images, phase, coordinates, the cloud and both devices."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.conventions import TWO_PI, Axis, Lattice, Map, raw_per_grey
from fpplab.core.depth import DepthRange
from fpplab.core.errors import FppError
from fpplab.core.geometry import RigidTransform
from fpplab.core.robust import error_limit
from fpplab.devices import Frame
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.fringes import pattern_image
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded, Wrapped, wrapped_phase
from fpplab.phase.bounds import widest_interval_share
from fpplab.phase.order_risk import order_risk
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.viewer import layouts
from fpplab.viewer.canvas import REACH, Canvas, CommandView, eight_bits, subsample_columns
from fpplab.viewer.colours import ColourScale

MIN_LOG_RISK, MAX_LOG_RISK = -12.0, -3.0
"""Decimal logarithms of the probabilities at the ends of the colour bar of the order risk."""
CAMERA, PROJECTOR, CLOUD = "world/camera", "world/projector", "world/cloud"
IMAGE, PATTERN = f"{CAMERA}/image", f"{PROJECTOR}/pattern"


@dataclass(frozen=True)
class ShownFrame:
    """A camera image as it is sent to be shown."""

    image: NDArray[Any]  # raw levels, with at most `SHOWN_COLUMNS` columns
    index: int  # of the image in the plan
    bits: int  # bit depth of the levels

    @classmethod
    def of(cls, frame: Frame) -> ShownFrame:
        return cls(subsample_columns(frame.image).copy(), frame.index, frame.settings.bits)


@dataclass(frozen=True, eq=False)
class Colouring:
    """Values of points as their colours."""

    name: str  # heading, and name of the entity
    values: NDArray[np.floating[Any]]  # (N,), NaN where not known
    scale: ColourScale  # their colours

    @property
    def entity(self) -> str:
        return f"world/coloured/{self.name.replace(' ', '_')}"


class MeasurementView(CommandView):
    """Images and maps on the right; on the left the part, in several colourings, and the rig."""

    def arrange_views(self) -> None:
        self._shown_plan: tuple[Plan, tuple[int, int], Lattice] | None = None
        self._shown_calibration: Calibration | None = None
        self._shown_frames: dict[int, NDArray[np.generic]] = {}
        self.canvas.directions("world")
        self.canvas.arrange(self.arrangement())

    def arrangement(self, colourings: Sequence[Colouring] = ()) -> Any:
        """Lay out scenes on the left and images on the right; coordinates of the coded axes only."""
        import rerun.blueprint as rrb

        return rrb.Horizontal(
            self.scenes(colourings),
            rrb.Grid(*self.pictures(), grid_columns=2, name="Images"),
            column_shares=[5, 4],
        )

    def scenes(self, colourings: Sequence[Colouring] = ()) -> Any:
        import rerun.blueprint as rrb

        around = f"/{REACH['part']}"
        coloured = [
            layouts.with_bar(
                layouts.scene(colouring.name, [f"/{colouring.entity}", around]),
                f"/bars/{colouring.entity}",
                colouring.name,
            )
            for colouring in colourings
        ]
        rig = layouts.scene("Rig", [f"/{CAMERA}/**", f"/{PROJECTOR}/**", f"/{CLOUD}", f"/{REACH['rig']}"])
        part = layouts.scene("Part", [f"/{CLOUD}", around])
        if not colourings:
            return rrb.Tabs(rig, part, active_tab=0, name="Scene")
        first = 1 if colourings[0].name == "Error" else 0
        return rrb.Tabs(part, *coloured, rig, active_tab=first, name="Scene")

    def pictures(self) -> list[Any]:
        axes: tuple[Axis, ...] = self._shown_plan[0].axes if self._shown_plan else ("x", "y")
        coordinates = {"x": ("Projector columns u", "/maps/u"), "y": ("Projector rows v", "/maps/v")}
        listed = [
            ("Camera", f"/{IMAGE}"),
            ("Pattern", f"/{PATTERN}"),
            ("Wrapped phase", "/maps/phase"),
            ("Modulation", "/maps/modulation"),
            *(coordinates[axis] for axis in axes),
        ]
        return [layouts.image(name, origin) for name, origin in listed]

    def plan(self, plan: Plan, size: tuple[int, int], lattice: Lattice) -> None:
        self._shown_plan = (plan, size, lattice)
        self.canvas.arrange(self.arrangement())

    def frame(self, frame: ShownFrame) -> None:
        self.canvas.at("frame", frame.index)
        self.canvas.picture(IMAGE, eight_bits(frame.image, frame.bits))
        if self._shown_plan is not None:
            plan, size, lattice = self._shown_plan
            index, step, _ = list(plan.steps())[[i for images in plan.passes for i in images][frame.index]]
            self.canvas.picture(PATTERN, subsample_columns(pattern_image(plan, index, step, size, lattice)))
            self._collect(frame, plan, index, step)

    def _collect(self, frame: ShownFrame, plan: Plan, index: int, step: int) -> None:
        fringe, frames = plan.sets[index], self._shown_frames
        if step == 0:
            frames.clear()
        frames[step] = frame.image
        if isinstance(fringe, FringeSet) and len(frames) == fringe.images:
            self._phase(wrapped_phase([frames[n] for n in range(fringe.images)], fringe), frame.bits)

    def _phase(self, wrapped: Wrapped, bits: int) -> None:
        # Below a modulation of two grey levels a phase is noise.
        faint = 2.0 * raw_per_grey(bits)
        phase = np.where(wrapped.modulation >= faint, wrapped.phase, np.float32(np.nan))
        self.canvas.map("maps/phase", phase, ColourScale("Phase", "rad", "twilight", 0.0, TWO_PI))

    def calibration(self, calibration: Calibration) -> None:
        self._shown_calibration = calibration
        show_devices(self.canvas, calibration)

    def maps(self, decoded: Decoded) -> None:
        # decoded (h, w)
        shown = (
            ("u", decoded.u, "Projector column u", "px", "viridis"),
            ("v", decoded.v, "Projector row v", "px", "viridis"),
            ("modulation", decoded.modulation, "Modulation", "grey levels of 255", "inferno"),
        )
        for name, values, quantity, unit, colours in shown:
            if np.isfinite(values).any():
                scale = ColourScale.spanning(quantity, unit, colours, values)
                self.canvas.map(f"maps/{name}", values, scale, static=True)

    def results(
        self,
        decoded: Decoded | None,
        cloud: Cloud,
        depth: DepthRange | None,
        errors_um: NDArray[np.floating[Any]] | None,
    ) -> None:
        # errors_um (N,) µm
        if decoded is not None:
            self.maps(decoded)
        self.cloud(cloud)
        risk = None if decoded is None else self._risk(decoded, cloud, depth)
        shown = colourings(cloud, risk, errors_um)
        for colouring in shown:
            self.canvas.cloud(colouring.entity, cloud.points, colouring.scale.colours_of(colouring.values))
            self.canvas.bar(f"bars/{colouring.entity}", colouring.scale)
        self.canvas.arrange(self.arrangement(shown))

    def cloud(self, cloud: Cloud) -> None:
        if cloud.rgb is not None:
            bright = max(float(np.percentile(cloud.rgb, 98)), 1.0)
            colours = np.clip(cloud.rgb * (255.0 / bright), 0.0, 255.0).astype(np.uint8)
        elif cloud.colour is not None:
            bright = max(float(np.percentile(cloud.colour, 98)), 1.0)
            colours = ColourScale("Grey level", "", "gray", 0.0, bright).colours_of(
                cloud.colour.astype(np.float32)
            )
        else:
            colours = depth_scale(cloud).colours_of(cloud.points[:, 2])
        self.canvas.cloud(CLOUD, cloud.points, colours)
        self.canvas.open_on("part", CLOUD, cloud.points)
        self.canvas.open_on("rig", CLOUD, cloud.points)

    def _risk(self, decoded: Decoded, cloud: Cloud, depth: DepthRange | None) -> Map | None:
        if self._shown_plan is None or cloud.pixels is None:
            return None
        plan, size, _ = self._shown_plan
        with suppress(FppError):  # a plan that this calibration cannot unwrap has no known risk
            bounds = self._shown_calibration and decoding_bounds(plan, self._shown_calibration, depth)
            interval_shares = {axis: widest_interval_share(bounds or None, axis, size) for axis in plan.axes}
            u, v = cloud.pixels.T
            return np.asarray(order_risk(decoded, plan, size, interval_shares)[v, u])
        return None


def show_devices(canvas: Canvas, calibration: Calibration) -> None:
    reach = 0.5 * calibration.baseline_mm
    canvas.device(CAMERA, calibration.camera, RigidTransform.identity(), reach)
    canvas.device(PROJECTOR, calibration.projector, calibration.T_projector_camera.inverse(), reach)


def depth_scale(cloud: Cloud) -> ColourScale:
    return ColourScale.spanning("Distance z from the camera", "mm", "viridis_r", cloud.points[:, 2])


def colourings(
    cloud: Cloud, risk: NDArray[np.floating[Any]] | None, errors_um: NDArray[np.floating[Any]] | None
) -> list[Colouring]:
    # risk (N,); errors_um (N,) µm
    listed = []
    if errors_um is not None:
        limit = error_limit(errors_um)
        scale = ColourScale("Signed distance from the true shape", "µm", "RdBu_r", -limit, limit)
        listed.append(Colouring("Error", errors_um, scale))
    sigma_mm = cloud.sigma_mm if cloud.sigma_mm is not None else cloud.sigma_along_ray_mm
    if sigma_mm is not None:
        sigma_um = 1e3 * sigma_mm
        quantity = "Standard uncertainty" + ("" if cloud.sigma_mm is not None else " by noise")
        listed.append(
            Colouring("Uncertainty", sigma_um, ColourScale.spanning(quantity, "µm", "magma", sigma_um))
        )
    if risk is not None:
        with np.errstate(divide="ignore"):
            exponent = np.maximum(np.log10(risk), MIN_LOG_RISK)
        quantity = "Probability of a wrong fringe order, decimal logarithm"
        scale = ColourScale(quantity, "", "plasma", MIN_LOG_RISK, MAX_LOG_RISK)
        listed.append(Colouring("Order risk", exponent, scale))
    listed.append(Colouring("Depth", cloud.points[:, 2], depth_scale(cloud)))
    return listed
