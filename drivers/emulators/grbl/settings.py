"""The settings of a GRBL 1.1 controller, as `$$` lists them."""

from __future__ import annotations

DEFAULTS: dict[int, float] = {
    0: 10, 1: 25, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.010, 12: 0.002, 13: 0,
    20: 1, 21: 1, 22: 1, 23: 0, 24: 60.0, 25: 600.0, 26: 250, 27: 2.0, 30: 1000.0, 31: 0.0, 32: 0,
    100: 400.0, 101: 400.0, 102: 400.0, 110: 1200.0, 111: 1200.0, 112: 1200.0,
    120: 100.0, 121: 100.0, 122: 100.0, 130: 200.0, 131: 200.0, 132: 200.0,
}  # fmt: skip
"""Settings by number, for a rail of 200 mm with a screw of 4 mm pitch and 1600 microsteps per revolution."""

_WITH_DECIMALS = {11, 12, 24, 25, 27, *range(100, 133)}


class GrblSettings(dict[int, float]):
    """Settings by number, and what they mean for one axis, 0 … 2."""

    def report_lines(self) -> list[str]:
        """Compose the answer to `$$`."""
        return [
            f"${n}={value:.3f}" if n in _WITH_DECIMALS else f"${n}={value:.0f}" for n, value in self.items()
        ]

    def flag(self, number: int) -> bool:
        return bool(self[number])

    def homes_down(self, axis: int) -> bool:
        """Return whether the home switch is at the negative end of an axis ($23)."""
        return bool(int(self[23]) >> axis & 1)

    def steps_per_mm(self, axis: int) -> float:
        """Return the resolution of an axis ($100 … $102)."""
        return self[100 + axis]

    def rate_mm_s(self, axis: int) -> float:
        """Return the greatest speed of an axis ($110 … $112, which are in mm/min)."""
        return self[110 + axis] / 60

    def acceleration_mm_s2(self, axis: int) -> float:
        """Return the greatest acceleration of an axis ($120 … $122)."""
        return self[120 + axis]

    def travel_mm(self, axis: int) -> float:
        """Return the greatest travel of an axis ($130 … $132)."""
        return self[130 + axis]
