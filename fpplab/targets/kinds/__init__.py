"""Kinds of boards: a module each, with one subclass of `BoardLayout`, named as target files name it."""

from __future__ import annotations

from importlib import import_module
from inspect import isabstract
from pkgutil import iter_modules

from fpplab.targets.layout import BoardLayout


def _listed() -> dict[str, type[BoardLayout]]:
    layouts = {}
    # In reverse alphabetical order messages list the kinds as they always have.
    for name in sorted((module.name for module in iter_modules(__path__)), reverse=True):
        module = import_module(f"{__name__}.{name}")
        own = [
            member for member in vars(module).values() if getattr(member, "__module__", "") == module.__name__
        ]
        (layout,) = [member for member in own if isinstance(member, type) and issubclass(member, BoardLayout)]
        assert not isabstract(layout), f"{layout} leaves out {sorted(layout.__abstractmethods__)}"
        layouts[name] = layout
    return layouts


KINDS: dict[str, type[BoardLayout]] = _listed()  # the layout of each kind of board, by name

OWN_FIELDS: dict[str, dict[str, type[BoardLayout]]] = {}
"""The fields that only some kinds have, each with the layouts that have it by the name of the kind."""

for _kind, _layout in KINDS.items():
    for _field in _layout.model_fields:
        if _field not in BoardLayout.model_fields:
            OWN_FIELDS.setdefault(_field, {})[_kind] = _layout
