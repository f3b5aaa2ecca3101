"""The licences of dependencies: as docs/licences.md tells them, and as the packages declare them."""

import re
import tomllib
from importlib import metadata

from tests.support.commands import ROOT

PAGE = ROOT / "docs" / "licences.md"
ROW = re.compile(r"^\|(?: ([a-z]+))? \| (?!package)([\w-]+) \| ([\w ]+) \|.*\|$", re.MULTILINE)
IN_THE_CORE = {"Apache", "BSD", "MIT", "MPL", "PSF"}
"""What an installation without extras may contain."""
SPELLINGS = {"PSF": ("python software foundation", "psf-2.0")}
"""What packages call some licences."""
SAY_NOTHING = {"embreex"}
"""Packages whose own words are the licence's text alone."""


def stated() -> list[tuple[str, str, str]]:
    """Extra, package and licence of each row of the page."""
    rows = ROW.findall(PAGE.read_text(encoding="utf-8"))
    return [(extra, package, licence) for extra, package, licence in rows]


def required() -> set[tuple[str, str]]:
    """Extra and package of each dependency, those of developers left out."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = {"": project["dependencies"], **project["optional-dependencies"]}
    return {
        (extra, re.split(r"[^\w-]", line, maxsplit=1)[0])
        for extra, lines in groups.items()
        if extra not in ("all", "dev")
        for line in lines
    }


def declared(package: str) -> str:
    """What an installed package says of its licence, in lower case."""
    about = metadata.metadata(package)
    classifiers = [line for line in about.get_all("Classifier", []) if line.startswith("License")]
    return " ".join([about.get("License-Expression") or "", about.get("License") or "", *classifiers]).lower()


def complaints() -> list[str]:
    """What is missing from the page, wrong on it, or may not be there."""
    rows, wanted = stated(), required()
    told = {(extra, package) for extra, package, _ in rows}
    found = [f"{package}: is not on the page" for _, package in sorted(wanted - told)]
    found += [f"{package}: is on the page, and no dependency" for _, package in sorted(told - wanted)]
    for extra, package, licence in rows:
        if not extra and licence not in IN_THE_CORE:
            found.append(f"{package}: {licence} may not be among what is always installed")
        try:
            words = declared(package)
        except metadata.PackageNotFoundError:
            continue
        spellings = SPELLINGS.get(licence, (licence.lower(),))
        if package not in SAY_NOTHING and not any(spelling in words for spelling in spellings):
            found.append(f"{package}: the page says {licence}, the package {words[:80]!r}")
    return found
