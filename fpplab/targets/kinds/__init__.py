"""Kinds of boards: a module each, with one subclass of `BoardLayout`, named as target files name it."""

from fpplab.core.tagged_union import concrete_subclasses, import_members
from fpplab.targets.layout import BoardLayout

import_members(__name__, __path__)

_LAYOUTS = {
    layout.__module__.rpartition(".")[2]: layout
    for layout in concrete_subclasses(BoardLayout)  # type: ignore[type-abstract]
}

# In reverse alphabetical order messages list the kinds as they always have.
KINDS: dict[str, type[BoardLayout]] = dict(sorted(_LAYOUTS.items(), reverse=True))

OWN_FIELDS: dict[str, dict[str, type[BoardLayout]]] = {}
"""The fields that only some kinds have, each with the layouts that have it by the name of the kind."""

for _kind, _layout in KINDS.items():
    for _field in _layout.model_fields:
        if _field not in BoardLayout.model_fields:
            OWN_FIELDS.setdefault(_field, {})[_kind] = _layout
