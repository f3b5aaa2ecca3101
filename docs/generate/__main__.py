"""`python -m docs.generate`: make the pictures by running the pages, and build the site."""

import argparse
import sys

from docs.generate.pages import PageError
from docs.generate.site import build_site, make_pictures


def main() -> int:
    """Make pictures and site; what has not changed is not run again.

    Returns
    -------
    int
        0 when it is built, 1 when a page shows what does not happen or MkDocs warns.
    """
    argparse.ArgumentParser(prog="python -m docs.generate", description=__doc__).parse_args()
    try:
        make_pictures()
        print(build_site())
    except PageError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
