"""Build the site from the pages and the pictures that running them has made."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from docs.generate.pages import DOCS, ROOT, PageError
from docs.generate.running import GALLERY, pictures_of, run_once, verdict_of

SITE = ROOT / "build" / "docs" / "site"


def make_pictures() -> None:
    """Run the pages and scripts whose pictures the site shows, unless they were run.

    Raises
    ------
    PageError
        One shows what does not happen.
    """
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # scripts are processes of their own
        scripts = {pool.submit(verdict_of, script): script for script in GALLERY}
        try:
            for page in sorted(DOCS.rglob("*.md")):
                if pictures_of(page) and page.stem != "gallery":
                    run_once(page)
                    print(page.relative_to(DOCS), flush=True)
            for script in as_completed(scripts):
                script.result()
                print(scripts[script].relative_to(ROOT), flush=True)
        except PageError:
            pool.shutdown(cancel_futures=True)
            raise


def build_site() -> Path:
    """Build the site.

    Returns
    -------
    Path
        Its first page.

    Raises
    ------
    PageError
        MkDocs warns of something.
    """
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict"]
    # The theme's word on the future of MkDocs is in docs/decisions/installation-and-documentation.md.
    settings = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=settings, capture_output=True, text=True, check=False)
    if done.returncode or done.stdout or done.stderr:
        raise PageError(f"mkdocs:\n{done.stdout}{done.stderr}")
    return SITE / "index.html"
