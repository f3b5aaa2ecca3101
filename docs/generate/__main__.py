"""`python -m docs.generate`: run the pages and scripts whose pictures the site shows."""

from __future__ import annotations

import sys

from docs.generate.pages import DOCS, ROOT, PageError
from docs.generate.running import GALLERY, pictures_of, run_once, verdict_of


def main() -> int:
    """Make all pictures; those of pages that have not changed are there already.

    Returns
    -------
    int
        0 when all have run, 1 when one shows what does not happen.
    """
    try:
        for page in sorted(DOCS.rglob("*.md")):
            if pictures_of(page) and page.stem != "gallery":
                print(f"{page.relative_to(DOCS)} …", flush=True)
                run_once(page)
        for script in GALLERY:
            print(f"{script.relative_to(ROOT)} …", flush=True)
            verdict_of(script)
    except PageError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
