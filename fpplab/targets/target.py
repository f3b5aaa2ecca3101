"""Characterisation boards as target files describe them.

The frame of a board has its origin at the board's centre, x to the right, y down and z away
from the viewer, in mm; points lie in z = 0 and are known by their row in `Target.points`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import create_model, model_validator

from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.targets.detection import detect
from fpplab.targets.drawing import covered_share
from fpplab.targets.fields import GridFields, PrintFields
from fpplab.targets.kinds import KINDS, OWN_FIELDS
from fpplab.targets.layout import BoardLayout
from fpplab.targets.views import Detection

if TYPE_CHECKING:
    KindName = str
else:
    KindName = Literal[tuple(KINDS)]


def _own_fields() -> dict[str, Any]:
    """Collect the fields of single kinds; what one kind requires may be missing from files of the others."""
    own: dict[str, Any] = {}
    for name, owners in OWN_FIELDS.items():
        layout = next(iter(owners.values()))
        field = layout.model_fields[name]
        hint = get_type_hints(layout, include_extras=True)[name]
        hint, default = (hint | None, None) if field.is_required() else (hint, field.default)
        own[name] = (hint, default)
    return own


_KindFields: Any = create_model("_KindFields", __base__=GridFields, **_own_fields())
_KindFields.described_by = tuple({layout for owners in OWN_FIELDS.values() for layout in owners.values()})


class Target(PrintFields, _KindFields, GridFields):  # type: ignore[misc] # fields of the kinds that there are
    """A flat board with points of interest, as a target file describes it.

    `kind` names a module of `fpplab.targets.kinds`, such as `circles` (points are their centres),
    `checkerboard` (inner corners) or `charuco` (inner corners that are identified by markers, so that part
    of the board suffices). The module says what the board is like and which further fields a file of the
    kind has; here those are None, or have their default, for the other kinds.
    """

    kind: KindName
    """Name of the kind of board: a module of `fpplab.targets.kinds`."""

    @classmethod
    def load(cls, path: Path | str) -> Target:
        """Read a target file.

        Parameters
        ----------
        path : Path or str
            Of the file, or the name of one that comes with fpplab.

        Returns
        -------
        Target
            The board.

        Raises
        ------
        ConfigError
            The file cannot be read or describes no board that can be.
        """
        return config.load_document(config.find_config(path, "target"), cls, "target")

    @model_validator(mode="after")
    def _is_sound(self) -> Target:
        for name, owners in OWN_FIELDS.items():
            value = getattr(self, name)
            if value and self.kind not in owners:
                raise ValueError(f"'{name}' belongs to kind {' or '.join(owners)}, not to {self.kind}")
            if value is None and self.kind in owners and owners[self.kind].model_fields[name].is_required():
                raise ValueError(f"'{name}' is missing; kind {self.kind} needs it")
        self.layout.check()
        return self

    @property
    def layout(self) -> BoardLayout:
        """What boards of the kind are like, with the values of this one."""
        kind = KINDS[self.kind]
        return kind.model_construct(**{name: getattr(self, name) for name in kind.model_fields})

    def points(self) -> Floats:
        """Compute the points of interest, row by row.

        Returns
        -------
        Floats
            (P, 3) in mm in the board's frame, z = 0; the row of a point is its id.
        """
        return self.layout.points()

    @property
    def symmetric(self) -> bool:
        """Whether the board looks the same after half a turn."""
        return self.layout.symmetric

    def image(self, px_per_mm: float) -> NDArray[np.uint8]:
        """Draw the reflectance (height, width) of the whole board, 0 to 255, antialiased by area.

        The image's borders are the board's: where the size is not a whole number of pixels, the scale
        along that axis is adapted.
        """
        share = covered_share(self.layout.shapes(), self.size_mm, px_per_mm)
        level = self.background + (self.foreground - self.background) * share
        return np.asarray(np.rint(255.0 * level), np.uint8)

    def detect(self, image: NDArray[Any]) -> Detection | None:
        """Find the board in a grey image (height, width); None where it is not there as a whole.

        A ChArUco board is found in part as well.
        """
        return detect(self.layout, image)
