"""YAML without what files from strangers could do by it: tags, endless aliases, odd numbers, dates."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import yaml


@dataclass(frozen=True)
class YamlLimits:
    """Limits of a YAML text."""

    max_characters: int = 2_000_000  # length of the text (chosen)
    max_nodes: int = 100_000  # number of values, those that aliases repeat included (chosen)
    max_depth: int = 50  # number of mappings and lists inside one another (chosen)


LIMITS = YamlLimits()
TOO_DEEP = f"there are more than {LIMITS.max_depth} mappings and lists inside one another"
TOO_MANY = f"there are more than {LIMITS.max_nodes} values, those that aliases repeat included"


_SURROGATE = re.compile("[\ud800-\udfff]")
_NULL, _BOOL, _INT, _FLOAT = (f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float"))
_RESOLVERS = (
    (_NULL, r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    (
        _BOOL,
        r"^(?:yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF)$",
        list("yYnNtTfFoO"),
    ),
    (_INT, r"^[-+]?(?:0|[1-9][\d_]{0,99})$", list("-+0123456789")),
    (
        _FLOAT,
        r"^[-+]?(?:\d[\d_]*\.[\d_]*(?:[eE][-+]?\d+)?|\.\d[\d_]*(?:[eE][-+]?\d+)?|\d[\d_]*[eE][-+]?\d+"
        r"|\.(?:inf|Inf|INF))$|^\.(?:nan|NaN|NAN)$",
        list("-+0123456789."),
    ),
)


class _Loader(yaml.SafeLoader):
    """Refuses tags, keys that are given twice, and what is too large or too deep, while it is composed."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._nodes = 0

    def get_single_node(self) -> yaml.Node | None:
        node = super().get_single_node()
        if node is not None:
            _measure(node, {}, 0)
        return node

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        tag = getattr(event, "tag", None)
        if tag is not None:
            raise _refusal(
                f"the tag '{tag}' is not allowed: values are words, numbers, lists, mappings", event
            )
        self._nodes += 1
        self._depth += 1
        if self._depth > LIMITS.max_depth + 1:
            raise _refusal(TOO_DEEP, event)
        if self._nodes > LIMITS.max_nodes:
            raise _refusal(TOO_MANY, event)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


class _QuickLoader(_Loader):
    """Takes what a text consists of from the C library; what that refuses, `_Loader` refuses in its words."""

    def __init__(self, text: str) -> None:
        super().__init__("")
        events = yaml.CSafeLoader(text)
        vars(self).update(
            {name: getattr(events, name) for name in ("check_event", "peek_event", "get_event")}
        )


def _mapping(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    keys: set[Any] = set()
    for key_node, _ in node.value:
        if not isinstance(key_node, yaml.ScalarNode):
            raise _refusal("a key is not a word", key_node)
        key = loader.construct_object(key_node)
        if key in keys:
            raise _refusal(f"key {key!r} is given twice", key_node)
        keys.add(key)
    return {
        loader.construct_object(key): loader.construct_object(value, deep=True) for key, value in node.value
    }


_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping)
_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in _RESOLVERS:
    _Loader.add_implicit_resolver(_tag, re.compile(_pattern), _first)


def _measure(node: yaml.Node, counts: dict[int, int], depth: int) -> int:
    """Count the values of a node, each as often as aliases repeat it; refuse too many, or too deep ones."""
    if depth > LIMITS.max_depth:
        raise _refusal(TOO_DEEP, node)
    if isinstance(node, yaml.ScalarNode) and _SURROGATE.search(node.value):
        raise _refusal("a word holds half a character, a lone surrogate", node)
    if id(node) not in counts:
        counts[id(node)] = 0  # while its parts are counted: 0 marks one that is part of itself
        parts = node.value if isinstance(node, yaml.CollectionNode) else []
        inside = [part for pair in parts for part in pair] if isinstance(node, yaml.MappingNode) else parts
        count = 1
        for part in inside:
            count += _measure(part, counts, depth + 1)
            if count > LIMITS.max_nodes:
                raise _refusal(TOO_MANY, part)
        counts[id(node)] = count
    if counts[id(node)] == 0:
        raise _refusal("an alias refers to a value that it is part of", node)
    return counts[id(node)]


def _refusal(problem: str, at: Any) -> yaml.MarkedYAMLError:
    return yaml.constructor.ConstructorError(None, None, problem, at.start_mark)


def load_yaml(text: str) -> Any:
    if len(text) > LIMITS.max_characters:
        raise ValueError(f"it has {len(text)} characters, more than {LIMITS.max_characters}")
    if "\t" not in text:  # which the C library takes in more places
        with suppress(yaml.YAMLError, UnicodeError):
            return yaml.load(text, _QuickLoader)
    return yaml.load(text, _Loader)
