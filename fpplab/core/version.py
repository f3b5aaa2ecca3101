"""The version of fpplab, which recorded searches and reports name."""

__version__ = "0.2.0"
