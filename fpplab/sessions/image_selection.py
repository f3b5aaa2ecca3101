"""Which images of another program, in which order: numbered names, lists, patterns, files of many images."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

from fpplab.core.config import read_text
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.file_kinds import IMAGES, describe_file
from fpplab.core.progress import Say, ignore
from fpplab.sessions.image_files import ImagePlace, places_in
from fpplab.sessions.image_names import NumberedNames, first_names, names_in


@dataclass(frozen=True)
class ImageSelection:
    """Where images are and in which order they were taken."""

    places: tuple[Path, ...]  # one folder, or image files in the order taken
    names: str | None = None  # the images of the folder
    first: int = 0  # number of the first image, by which also `skip` counts; with {set} and {step}, of both
    first_step: int | None = None  # number of the first step, where it is another
    skip: tuple[int, ...] = ()  # numbers of images that are not the plan's, such as white and black ones

    @property
    def title(self) -> str:
        if not self.places:
            return str(self.names).removeprefix("@")
        return str(self.places[0]) + (" …" if len(self.places) > 1 else "")

    def images(
        self, sets: Sequence[int] | None = None, warn: Say = ignore, tell: Say = ignore
    ) -> list[ImagePlace]:
        numbered = self._numbered_names()
        if numbered is not None:
            return self._by_numbers(numbered, sets)
        if self.first_step is not None:
            raise ConfigError("--first-step goes with names that have a {step}")
        files = self._named_files(warn, tell)
        every = [place for file in files for place in places_in(file)]
        for number in self.skip:
            if not self.first <= number < self.first + len(every):
                raise ConfigError(
                    f"--skip names image {number}, and there are {len(every)}, counted from {self.first}"
                )
        taken = [place for number, place in enumerate(every, self.first) if number not in self.skip]
        _check_count(self.title, taken, sets)
        return taken

    def _numbered_names(self) -> NumberedNames | None:
        """The names as a format; None where they are a pattern, a list or files."""
        if self.names is None or self.names.startswith("@") or _is_pattern(self.names):
            return None
        names = NumberedNames.parse(self._only_folder(), self.names, self.first, self.first_step)
        if names.has_steps and self.skip:
            raise ConfigError(
                "--skip counts images by one number; with {set} and {step} in --frames, files of other names "
                "are left out by themselves"
            )
        return names

    def _by_numbers(self, names: NumberedNames, sets: Sequence[int] | None) -> list[ImagePlace]:
        expected = names.expected(sets, len(self.skip))
        skipped = [numbers for numbers in expected if not names.has_steps and numbers[0] in self.skip]
        if len(skipped) < len(set(self.skip)):
            raise ConfigError(
                f"--skip is {first_names(map(str, self.skip))}: there are {len(expected)} images, counted "
                f"from {self.first}"
            )
        taken = [numbers for numbers in expected if numbers not in skipped]
        names.check(taken, skipped, sets is not None)
        places = [places_in(names.folder / names.name(numbers)) for numbers in taken]
        for inside in places:
            if len(inside) > 1:
                raise DataError(
                    f"{inside[0].path}: holds {len(inside)} images, and --frames names each of them; name "
                    "the file itself in place of the folder, or give '*.tif'"
                )
        return [inside[0] for inside in places]

    def _only_folder(self) -> Path:
        if len(self.places) != 1:
            raise ConfigError(f"--frames is '{self.names}': name the one folder that it is for")
        if not self.places[0].is_dir():
            raise ConfigError(f"{self.places[0]}: is not a folder; --frames names the images of one")
        return self.places[0]

    def _named_files(self, warn: Say, tell: Say) -> list[Path]:
        if self.names is not None and self.names.startswith("@"):
            files = self._files_in_list(Path(self.names[1:]))
        elif self.names is not None:
            return self._files_matching(self.names, tell)
        else:
            files = list(self.places)
            folders = [place for place in files if place.is_dir()]
            if folders:
                if (kind := describe_file(folders[0])) != IMAGES:
                    raise ConfigError(f"{folders[0]}: is {kind}; expected image files, or a folder of images")
                raise ConfigError(
                    f"--frames is missing: say what the images in {folders[0]} are called, such as "
                    "'f_{index:02d}.png' or '*.png'"
                )
        _check_files(files)
        ordered = sorted(files, key=_by_number)
        if files == sorted(files) != ordered:
            warn(
                f"the images are taken in the order of the letters in their names, {_some(files)}; by their "
                f"numbers they are {_some(ordered)}: a folder with --frames '*{files[0].suffix}' does so"
            )
        return files

    def _files_in_list(self, path: Path) -> list[Path]:
        """Files by a list, relative to the folder that is named, or else to the list's own."""
        folder = self._only_folder() if self.places else path.parent
        lines = (line.strip() for line in read_text(path).splitlines())
        names = [_listed_name(line) for line in lines if line and not re.match(r"#(\s|$)", line)]
        for name in names:
            if PureWindowsPath(name).anchor or ".." in Path(name).parts:
                raise DataError(
                    f"{path}: names '{name}', which is not below {folder}; name that folder instead"
                )
        files = [folder / name for name in names]
        if not files:
            raise DataError(f"{path}: names no image")
        return files

    def _files_matching(self, pattern: str, tell: Say) -> list[Path]:
        folder = self._only_folder()
        if Path(pattern).is_absolute() or ".." in Path(pattern).parts or "**" in pattern:
            raise ConfigError(
                f"--frames is '{pattern}': a pattern of names below the folder, such as '*.png'"
            )
        matches = [
            path
            for path in folder.glob(_any_case(pattern))
            if path.is_file() and not path.name.startswith(".")
        ]
        if not matches:
            raise DataError(f"{folder}: has no file '{pattern}'; {names_in(folder)}")
        files = sorted(matches, key=_by_number)
        tell(f"{len(files)} files are taken in the order of the numbers in their names: {_some(files)}")
        return files


def numbers_of(text: str | None) -> tuple[int, ...]:
    numbers: set[int] = set()
    for part in text.split(",") if text else []:
        match = re.fullmatch(r"\s*(\d{1,6})(?:-(\d{1,6}))?\s*", part, re.ASCII)
        if match is None or int(match[2] or match[1]) < int(match[1]):
            raise ConfigError(f"--skip is '{text}': expected numbers of images, such as '0,1' or '0-1'")
        numbers |= set(range(int(match[1]), int(match[2] or match[1]) + 1))
    return tuple(sorted(numbers))


def _is_pattern(names: str) -> bool:
    return "{" not in names and any(sign in names for sign in "*?[")


def _any_case(pattern: str) -> str:
    """The pattern for capitals and small letters alike, as Windows takes it; sets in brackets stay."""
    parts = re.split(r"(\[[^]]+\])", pattern)
    return "".join(
        part
        if part.startswith("[")
        else re.sub(r"[^\W\d_]", lambda m: f"[{m[0].lower()}{m[0].upper()}]", part)
        for part in parts
    )


def _listed_name(line: str) -> str:
    quoted = re.fullmatch(r"""(["'])(.*)\1""", line)
    return (quoted[2] if quoted else line).replace("\\", "/")


def _by_number(path: Path) -> list[tuple[int, str]]:
    parts = re.split(r"(\d+)", path.as_posix())
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts if part]


def _check_files(files: Sequence[Path]) -> None:
    missing = [file for file in files if not file.is_file()]
    if missing:
        raise DataError(
            f"{missing[0].parent}: {len(missing)} of {len(files)} files do not exist "
            f"({first_names(file.name for file in missing)}); {names_in(missing[0].parent)}"
        )
    earlier: set[Path] = set()
    for file in files:
        if file.resolve() in earlier:
            raise DataError(f"{file}: is named twice; every step has an image of its own")
        earlier.add(file.resolve())


def _check_count(title: str, images: Sequence[ImagePlace], sets: Sequence[int] | None) -> None:
    if sets is None or len(images) == sum(sets):
        return
    planned = sum(sets)
    said = f"{title}: has {len(images)} images, and the plan {planned}"
    if len(images) > planned:
        raise DataError(
            f"{said}: {first_names(place.name for place in images[planned:])} would be left over; the plan "
            "lacks fringe sets or steps, or there are white, black or other images: --skip leaves those out"
        )
    raise DataError(f"{said}: the last {planned - len(images)} of the plan have none after {images[-1].name}")


def _some(files: Sequence[Path]) -> str:
    names = [file.name for file in files]
    return ", ".join(names) if len(names) < 5 else f"{names[0]}, {names[1]}, {names[2]} … {names[-1]}"
