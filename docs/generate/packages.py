"""The picture of fpplab's packages in their layers, drawn from the import contract."""

import tomllib
from html import escape

from docs.generate.pages import ROOT

WIDTH, ROW, GAP, MARGIN = 860, 34, 8, 12
FONT = "font-family='sans-serif' font-size='13'"


def layers() -> list[str]:
    """Give the rows of the contract, the uppermost first.

    Returns
    -------
    list of str
        Names of packages, `|` between those of one row.
    """
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    contracts = tool["importlinter"]["contracts"]
    return next(list(one["layers"]) for one in contracts if one.get("containers") == ["fpplab"])


def packages_svg() -> str:
    """Draw the packages: `drivers` and `sim` above, `fpplab` row by row.

    Returns
    -------
    str
        An SVG file.
    """
    rows = [["drivers", "sim"], *([name.strip() for name in row.split("|")] for row in layers())]
    height = 2 * MARGIN + len(rows) * (ROW + GAP) + GAP
    parts = [
        f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {WIDTH} {height}' width='{WIDTH}' {FONT}>",
        f"<rect width='{WIDTH}' height='{height}' fill='#ffffff'/>",
    ]
    for number, names in enumerate(rows):
        top = MARGIN + number * (ROW + GAP) + (GAP if number else 0)
        colour = "#fde7c8" if number == 0 else "#dbe9f6"
        box = (WIDTH - 2 * MARGIN - (len(names) - 1) * GAP) / len(names)
        for place, name in enumerate(names):
            left = MARGIN + place * (box + GAP)
            place_and_size = f"x='{left:.1f}' y='{top}' width='{box:.1f}' height='{ROW}' rx='5'"
            parts.append(f"<rect {place_and_size} fill='{colour}' stroke='#7a8ca0'/>")
            middle = f"x='{left + box / 2:.1f}' y='{top + ROW / 2 + 5:.1f}' text-anchor='middle'"
            parts.append(f"<text {middle} fill='#1b2733'>{escape(name)}</text>")
    return "\n".join([*parts, "</svg>\n"])
