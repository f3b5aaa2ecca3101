"""The rig as a session records it: which projector, which response, and whether it is still the same."""

from pathlib import Path
from typing import Any

from pydantic import ConfigDict

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Lattice
from fpplab.core.depth import DepthRange, first_stated
from fpplab.core.errors import DataError
from fpplab.core.session_names import PLAN, RIG
from fpplab.devices.rig import DepthSection
from fpplab.patterns.curve import Curve
from fpplab.patterns.mosaic import Bayer
from fpplab.patterns.plan import Plan

RigRecord = dict[str, Any] | None  # a rig as `Rig.described` gives it, or None for images from elsewhere


def read_rig(path: Path) -> RigRecord:
    file = path / RIG
    return config.parse_yaml(config.read_text(file), file) if file.exists() else None


def check_same_rig(began: RigRecord, now: RigRecord, path: Path) -> None:
    if now is not None and began != now:
        what = "item or pose" if _but_mounted(began) == _but_mounted(now) else "rig"
        raise DataError(f"{path}: was begun with another {what}; name another output, or add --force")


def _but_mounted(rig: RigRecord) -> dict[str, Any]:
    resolved = (rig or {}).get("resolved") or {}
    return {**(rig or {}), "resolved": {k: v for k, v in resolved.items() if k != "mounted"}}


def recorded_projector(rig: RigRecord, plan: Plan, path: Path) -> tuple[tuple[int, int], Lattice]:
    # returns size (width, height) px
    if rig is None and plan.projector_size:
        return plan.projector_size, Lattice.SQUARE
    try:
        projector = (rig or {})["resolved"]["projector"]
        return (int(projector["size"][0]), int(projector["size"][1])), Lattice(projector["lattice"])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise DataError(
            f"{path}: does not say how many pixels the projector had, and in which lattice; "
            "add 'projector_size' to the plan's fringes and import the images again"
        ) from error


def recorded_bayer(rig: RigRecord, path: Path) -> Bayer | None:
    camera = ((rig or {}).get("resolved") or {}).get("camera") or {}
    return config.validate(camera, _RecordedCamera, f"{path / RIG}: camera").bayer


class _RecordedCamera(Document):
    model_config = ConfigDict(extra="ignore")

    bayer: Bayer | None = None


def recorded_response(rig: RigRecord, path: Path) -> Curve | None:
    response = (rig or {}).get("response")
    return None if response is None else config.validate(response, Curve, f"{path}: response of the rig")


def recorded_depth(rig: RigRecord, plan: Plan, path: Path) -> DepthRange | None:
    stated = {key: value for key, value in (rig or {}).items() if key == "depth_mm"}
    return first_stated(
        (plan.depth_mm, f"{path / PLAN}: 'depth_mm'"),
        (config.validate(stated, DepthSection, path / RIG).depth_mm, f"{path / RIG}: 'depth_mm'"),
    )
