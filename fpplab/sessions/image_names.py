"""File names that count images: `f_{index:02d}.png`, `set{set}_step{step}.png`."""

from __future__ import annotations

import glob
import re
import string
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from fpplab.core.errors import ConfigError, DataError
from fpplab.sessions.limits import SESSION_LIMITS as LIMITS

NameNumbers = tuple[int, ...]  # the numbers in a file name: (index,) or (set, step)

_ALLOWED = (["index"], ["set", "step"])


@dataclass(frozen=True)
class NumberedNames:
    """A format of file names in a folder, and the numbers at which it begins to count."""

    folder: Path  # where the files are
    form: str  # with one `{index}`
    first: NameNumbers  # the least numbers: (index,) or (set, step)

    @classmethod
    def parse(cls, folder: Path, form: str, first: int, first_step: int | None) -> NumberedNames:
        fields = _format_fields(form)
        if fields == ["index"] and first_step is not None:
            raise ConfigError("--first-step goes with names that have a {step}; --first is the first {index}")
        if fields == ["index"]:
            return cls(folder, form, (first,))
        return cls(folder, form, (first, first if first_step is None else first_step))

    @property
    def has_steps(self) -> bool:
        return len(self.first) == 2

    def name(self, numbers: NameNumbers) -> str:
        return self.form.format(**dict(zip(self._fields, numbers, strict=True)))

    def existing(self) -> list[NameNumbers]:
        parts = list(string.Formatter().parse(self.form))
        pattern = "".join(glob.escape(text) + ("*" if field else "") for text, field, _, _ in parts)
        form = "".join(
            re.escape(text) + (rf"(?P<{field}>\d+)" if field else "") for text, field, _, _ in parts
        )
        names = [path.relative_to(self.folder).as_posix() for path in self.folder.glob(pattern)]
        matches = [match for name in names if (match := re.fullmatch(form, name, re.ASCII))]
        numbers = {tuple(int(match[field]) for field in self._fields) for match in matches}
        return sorted(number for number in numbers if (self.folder / self.name(number)).is_file())

    def expected(self, sets: Sequence[int] | None, skipped: int = 0) -> list[NameNumbers]:
        first = self.first[-1]
        if not self.has_steps:
            count = self._counted(n for (n,) in self.existing()) if sets is None else sum(sets) + skipped
            return [(first + k,) for k in range(count)]
        if sets is None:
            existing = self.existing()
            kinds = range(self.first[0], max((s for s, _ in existing), default=self.first[0] - 1) + 1)
            sets = [max(self._counted(n for s, n in existing if s == kind), 1) for kind in kinds]
        return [(self.first[0] + k, first + n) for k, count in enumerate(sets) for n in range(count)]

    def check(self, expected: Sequence[NameNumbers], skipped: Sequence[NameNumbers], planned: bool) -> None:
        existing = self.existing()
        missing = sorted(set(expected) - set(existing))
        surplus = sorted(set(existing) - set(expected) - set(skipped))
        if not expected:
            raise DataError(
                f"{self.folder}: has no image '{self.form}' from {self._begin(self.first)}; "
                f"{names_in(self.folder)}"
            )
        if missing:
            whole = f"the plan's {len(expected)} frames" if planned else f"{len(expected)} images"
            raise DataError(
                f"{self.folder}: {len(missing)} of {whole} are missing "
                f"({first_names(self.name(number) for number in missing)}); looked for '{self.form}' from "
                f"{self._begin(self.first)}{self._hint_at_other_numbers(expected, existing)}"
            )
        if surplus:
            those = f"the plan's {len(expected)}" if planned else f"those from {self._begin(self.first)}"
            raise DataError(
                f"{self.folder}: has {len(surplus)} images more than {those} "
                f"({first_names(self.name(number) for number in surplus)}): the plan lacks fringe sets or "
                "steps, these "
                "files belong elsewhere, or they are white, black or other images: --skip leaves those out"
            )

    @property
    def _fields(self) -> list[str]:
        return _ALLOWED[len(self.first) - 1]

    def _counted(self, numbers: Iterable[int]) -> int:
        return max(max(numbers, default=self.first[-1] - 1) - self.first[-1] + 1, 0)

    def _begin(self, numbers: NameNumbers) -> str:
        return " and ".join(f"{field} {n}" for field, n in zip(self._fields, numbers, strict=True))

    def _hint_at_other_numbers(self, expected: Sequence[NameNumbers], existing: Sequence[NameNumbers]) -> str:
        if not existing:
            return f"; {names_in(self.folder)}"
        low = tuple(map(min, zip(*existing, strict=True)))
        moved = {
            tuple(n - f + at for n, f, at in zip(numbers, self.first, low, strict=True))
            for numbers in expected
        }
        if low == self.first or moved != set(existing):
            return ""
        options = f"--first {low[0]}" + (f" --first-step {low[-1]}" if low[-1] != low[0] else "")
        return f"; they count from {self._begin(low)}: {options}"


def _format_fields(form: str) -> list[str]:
    try:
        parts = [part for part in string.Formatter().parse(form) if part[1] is not None]
        fields = sorted(str(field) for _, field, _, _ in parts)
        plain = all(re.fullmatch(r"(0?\d{1,2})?d?", str(spec)) and not way for _, _, spec, way in parts)
        inside = not Path(form).is_absolute() and ".." not in Path(form).parts
        if fields not in _ALLOWED or not plain or not inside or len(form) > 200:
            raise ValueError
    except ValueError:
        raise ConfigError(
            f"--frames is '{form}': expected one {{index}} such as 'f_{{index:02d}}.png', {{set}} and "
            "{step} such as 'set{set}_step{step}.png', a pattern such as '*.png', or '@list.txt'; files "
            "lie in the folder or below it"
        ) from None
    return fields


def names_in(folder: Path) -> str:
    if not folder.is_dir():
        return f"{folder} is no folder"
    names = sorted(path.name for path in folder.iterdir())
    return f"the folder has {first_names(names)}" if names else "the folder is empty"


def first_names(names: Iterable[str]) -> str:
    names = list(names)
    return ", ".join(names[: LIMITS.max_names_shown]) + (" …" if len(names) > LIMITS.max_names_shown else "")
