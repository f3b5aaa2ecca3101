"""How the bench looks in addition to its parameters: the board's sheet, and what stands around.

Both are found once geometry and light are matched, and proven in a pose from which they were not found: a
part that does not make the twin's images of it more similar is left out.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from sim.appearance import Appearance
from sim.matching.evaluation import pose_similarity
from sim.matching.reference import Reference
from sim.matching.scene.board_sheet import find_sheet, sharpened_sheet
from sim.matching.scene.surroundings import rebuild_surroundings
from sim.twin import Twin


@dataclass(frozen=True)
class AppearanceLimits:
    """When sheet and surroundings prove themselves."""

    max_poses: int = 8  # that are looked at (chosen, for speed)
    min_gain: float = 0.005  # of the mean SSIM of a pose that was left out (chosen)


LIMITS = AppearanceLimits()


@dataclass(frozen=True)
class PartTrial:
    """Whether a part of the appearance makes images more similar in a pose from which it was not found."""

    ssim_without: float  # mean SSIM of the pose's images
    ssim_with: float  # mean SSIM of the pose's images

    @property
    def accepted(self) -> bool:
        """Whether the images are more similar by more than noise explains."""
        return self.ssim_with > self.ssim_without + LIMITS.min_gain


@dataclass(frozen=True, eq=False)
class AppearanceTrial:
    """What was found of the appearance, and whether the twin has it."""

    pose: str  # name of the pose that was left out
    sheet: PartTrial  # of the board's sheet; SSIM over the board as the target outlines it
    surroundings: PartTrial  # SSIM of whole images
    appearance: Appearance  # what the twin has

    @property
    def accepted(self) -> bool:
        return self.sheet.accepted or self.surroundings.accepted

    def summary(self) -> dict[str, Any]:
        sheet, around = self.appearance.sheet, self.appearance.surroundings
        return {
            "pose": self.pose,
            "sheet": {
                **asdict(self.sheet),
                "accepted": self.sheet.accepted,
                "margins_mm": list(sheet.margins_mm),
                "rim_mm": sheet.rim_mm,
                "rim_reflectance": sheet.rim_reflectance,
                "texture": None if sheet.texture is None else float(sheet.texture.std()),
            },
            "surroundings": {
                **asdict(self.surroundings),
                "accepted": self.surroundings.accepted,
                "faces": 0 if around is None else len(around.mesh.faces),
            },
        }


def match_appearance(reference: Reference, twin: Twin) -> AppearanceTrial:
    """Find the board's sheet and the surroundings, as far as they prove themselves."""
    *others, held = reference.spread_poses(LIMITS.max_poses)
    bare = _similarity(reference, twin, held, None)
    sheet = find_sheet(reference, twin, others)
    sheet_trial = PartTrial(bare[1], _similarity(reference, twin, held, Appearance(sheet))[1])
    if sheet_trial.accepted:
        sheet = sharpened_sheet(reference, twin, sheet, others)
        sheet_trial = PartTrial(bare[1], _similarity(reference, twin, held, Appearance(sheet))[1])
    else:
        sheet = replace(sheet, texture=None)
    around = rebuild_surroundings(reference, twin, sheet, others)
    before = _similarity(reference, twin, held, Appearance(sheet))[0]
    after = _similarity(reference, twin, held, Appearance(sheet, around))[0] if around else before
    around_trial = PartTrial(before, after)
    appearance = _rebuild_accepted_from_all_poses(reference, twin, [*others, held], sheet_trial, around_trial)
    return AppearanceTrial(reference.sessions[held].path.name, sheet_trial, around_trial, appearance)


def _rebuild_accepted_from_all_poses(
    reference: Reference,
    twin: Twin,
    poses: Sequence[int],
    sheet_trial: PartTrial,
    surroundings_trial: PartTrial,
) -> Appearance:
    """Find what was accepted once more, from all poses; nothing without either."""
    if not (sheet_trial.accepted or surroundings_trial.accepted):
        return Appearance()
    final = find_sheet(reference, twin, poses)
    bare = replace(final, texture=None)
    final = sharpened_sheet(reference, twin, final, poses) if sheet_trial.accepted else bare
    around_all = rebuild_surroundings(reference, twin, final, poses) if surroundings_trial.accepted else None
    return Appearance(final, around_all)


def _similarity(
    reference: Reference, twin: Twin, pose: int, appearance: Appearance | None
) -> tuple[float, float]:
    """Mean SSIM of one pose's images, whole and over the board; without noise of the twin's."""
    if appearance is not None:
        twin = twin.with_appearance(appearance)
    whole, board = np.mean(pose_similarity(reference, twin, pose), axis=0)
    return float(whole), float(board)
