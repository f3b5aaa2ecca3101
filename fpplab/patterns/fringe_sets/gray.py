"""Reflected Gray code: black and white stripes whose levels number the cells along an axis."""

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from fpplab.core.conventions import Axis, Floats
from fpplab.patterns.fringe_sets.base import CodeSet


class Gray(CodeSet):
    """Bits of a reflected Gray code: cell `floor((u + 0.5) / cell_px)` shows the bits of its code word.

    Neighbouring cells differ in one bit. Alone it gives a coordinate as fine as its cells and its edges are;
    beside fringes along the same axis it says which period is meant. Cells of half a period or less
    (a complementary code) leave no doubt at the edges of periods.
    """

    kind: Literal["gray"] = "gray"
    """`gray`."""

    bits: Annotated[int, Field(ge=1, le=16)]
    """Bits of the code word, each with an image: they number 2^bits cells."""

    cell_px: Annotated[float, Field(gt=0)] = 1.0
    """Width of a cell in projector px along the axis."""

    first_cell: Annotated[int, Field(ge=0, lt=65536)] = 0
    """Number of the cell that begins at the projector's edge."""

    inverses: Literal["none", "each", "after"] = "none"
    """Inverted images: `each` follows its own, or all come `after` the last bit."""

    least_first: bool = False
    """Whether the finest bit comes first; by default it is the coarsest."""

    @classmethod
    def guessed(
        cls, images: Sequence[NDArray[np.bool_]], edges: Sequence[int], axis: Axis | None, length: int
    ) -> dict[str, Any] | None:
        """Find inverses and the order of bits; cells are as if the code reached over the projector."""
        if axis is None:
            return None
        half, inverses = len(images) // 2, "none"
        if len(images) % 2 == 0:
            if all(_is_inverse(*images[k : k + 2]) for k in range(0, 2 * half, 2)):
                inverses = "each"
            elif all(_is_inverse(images[k], images[half + k]) for k in range(half)):
                inverses = "after"
        bits = len(images) if inverses == "none" else half
        own = edges[:: 2 if inverses == "each" else 1][:bits]
        cell_px = float(max(1, int(np.ceil(length / 2**bits))))
        code = {"axis": axis, "bits": bits, "cell_px": cell_px, "inverses": inverses}
        return {**code, "least_first": own[0] > own[-1]}

    @property
    def images(self) -> int:
        return self.bits * (1 if self.inverses == "none" else 2)

    def light(self, step: int, coordinate: Floats, length: int) -> Floats:
        """Give the bit of the cells' words: 0 or 1."""
        index, inverted = divmod(step, self.bits)[::-1]
        if self.inverses == "each":
            index, inverted = divmod(step, 2)
        bit = index if self.least_first else self.bits - 1 - index
        cell = np.floor((np.asarray(coordinate) + 0.5) / self.cell_px).astype(np.int64) + self.first_cell
        word = cell ^ (cell >> 1)
        return np.asarray((word >> bit & 1) ^ inverted, np.float64)

    def waves(self, harmonics: int) -> Floats:
        """Give the changes of each bit, which an inverted image shows the other way round."""
        bits = np.eye(self.bits)
        if self.inverses == "none":
            return bits
        order = [2 * k + i for i in (0, 1) for k in range(self.bits)]
        both = np.concatenate([bits, -bits])
        return np.asarray(both[np.argsort(order)] if self.inverses == "each" else both)

    def other_orders(self) -> Iterator[tuple[str, NDArray[np.int64]]]:
        """Give the bits the other way round."""
        images = np.arange(self.images).reshape(-1, self.bits, 2 if self.inverses == "each" else 1)
        other = "false" if self.least_first else "true"
        meaning = f"the Gray code comes the other way round; write 'least_first: {other}'"
        yield meaning, images[:, ::-1].ravel()

    def finest_stripes(self, length: int) -> float:
        """Give the periods of the finest bit, of four cells each."""
        return length / (4.0 * self.cell_px)

    @property
    def short_name(self) -> str:
        return f"gray{self.bits}"

    def fault(self, length: int) -> str | None:
        """Refuse cells that the code words cannot number, or that are finer than pixels."""
        cells = self.first_cell + int(np.ceil(length / self.cell_px))
        if self.cell_px < 1.0:
            return f"cell_px' is {self.cell_px:g}: must be at least one pixel of the projector"
        if cells > 2**self.bits:
            needed = int(np.ceil(np.log2(cells)))
            return f"bits' is {self.bits}: {cells} cells of {self.cell_px:g} px need at least {needed}"
        return None


def _is_inverse(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> bool:
    return bool(np.mean(first != second) > 0.9)  # chosen: neighbouring bits of a code differ at half
