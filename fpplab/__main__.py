"""`python -m fpplab`."""

from fpplab.cli import main

if __name__ == "__main__":
    main()
