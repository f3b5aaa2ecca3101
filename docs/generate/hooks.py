"""What MkDocs calls while it builds the site: it adds generated pages and pictures, and tells links apart.

Pictures are those that `python -m docs.generate` has made by running the pages.
"""

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parents[2]))

from docs.generate.packages import packages_svg
from docs.generate.pages import DOCS, ROOT
from docs.generate.reference import PAGES
from docs.generate.running import PICTURES

SEARCH = Path(__file__).with_name("search_from_disk.js")
WITHOUT_PICTURES = "*Pictures appear once `make docs` has made them.*\n\n"
"""Told at the head of pages that are read in a clone."""


def on_files(files: Files, *, config: Any) -> Files:
    """Add what is not in the folder of the documentation."""
    for path, write in PAGES.items():
        files.append(File.generated(config, path, content=write()))
    files.append(File.generated(config, "generated/packages.svg", content=packages_svg()))
    for picture in sorted(PICTURES.rglob("*.png")):
        place = f"generated/{picture.relative_to(PICTURES).as_posix()}"
        files.append(File.generated(config, place, abs_src_path=str(picture)))
    return files


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Files) -> str:
    """Show links to files of the sources, which are not on the site, as their paths; it has the pictures."""
    markdown = markdown.replace(WITHOUT_PICTURES, "")
    if page.file.src_uri.startswith("decisions/"):
        page.meta["search"] = {"boost": 0.1}  # behind the pages that a user reads
    here = (DOCS / page.file.src_uri).parent

    def plain(found: re.Match[str]) -> str:
        words, target = found[1], found[2].partition("#")[0]
        if not target or re.match(r"[a-z]+:", target):
            return found[0]
        path = (here / target).resolve()
        if path.is_relative_to(DOCS) or not path.is_relative_to(ROOT):
            return found[0]
        return f"{words} (`{path.relative_to(ROOT).as_posix()}`)"

    return re.sub(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)", plain, markdown)


def on_post_page(output: str, *, page: Any, config: Any) -> str:
    """Put in what searches pages from the disk, in place of the script that the theme would fetch for it."""
    own = f"<script>{SEARCH.read_text(encoding='utf-8')}</script>"
    return re.sub(r'<script src="https://unpkg\.com/[^"]+"></script>', lambda _: own, output)
