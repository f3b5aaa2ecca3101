"""Objectives of a search, one module each; a module that is added here is found by listing the package."""

from fpplab.core.tagged_union import import_members

import_members(__name__, __path__)
