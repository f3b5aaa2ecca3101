"""What strangers read follows numpydoc: the public names, and the classes that drivers fill in."""

import inspect
import re
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

import pytest
from numpydoc.docscrape import FunctionDoc
from numpydoc.validate import validate

import fpplab
from fpplab.devices import (
    Camera,
    Device,
    Fixture,
    FlashingProjector,
    InstructableFixture,
    PosableFixture,
    Projector,
    Stage,
)
from tests.structure.measure import ROOT, working_tree

CODES = {
    "GL08": "no docstring",
    "SS03": "summary without a full stop",
    "PR01": "undocumented parameters",
    "PR02": "parameters that do not exist",
    "PR03": "parameters in another order",
    "RT01": "no Returns section",
    "YD01": "no Yields section",
}
CLASSES = [Camera, Fixture, Projector, Stage] + [
    thing for name in fpplab.__all__ if inspect.isclass(thing := getattr(fpplab, name))
]
FUNCTIONS = [thing for name in fpplab.__all__ if inspect.isfunction(thing := getattr(fpplab, name))]


INTERFACES = (
    Device,
    Camera,
    Projector,
    FlashingProjector,
    Stage,
    Fixture,
    InstructableFixture,
    PosableFixture,
)
OPTIONAL_HOOKS = (Device._setup, Projector._loads, Fixture._pose, Fixture._check)
HOOKS = [
    member
    for interface in INTERFACES
    for member in vars(interface).values()
    if inspect.isfunction(member)
    and (member in OPTIONAL_HOOKS or getattr(member, "__isabstractmethod__", False))
]
PACKAGES = {
    path.removesuffix("/__init__.py").replace("/", ".")
    for path in working_tree()
    if path.endswith("/__init__.py") and not path.startswith("sim/blender/")  # Blender's own interpreter
}


def place(thing: object) -> str:
    return f"{thing.__module__}.{thing.__qualname__}"  # type: ignore[attr-defined]


def members(cls: type) -> list[str]:
    """Names of public functions and properties that a class itself defines, but for overriding ones."""
    return [
        name
        for name, member in vars(cls).items()
        if isinstance(member, property | classmethod | staticmethod) or inspect.isfunction(member)
        if not name.startswith("_") and not getattr(member, "__override__", False)
    ]


@cache
def strangers_read() -> frozenset[str]:
    """Names behind a dot in examples and in Python blocks of pages, and those that docs/python.md lists."""
    examples = [path for path in (ROOT / "examples").rglob("*") if path.suffix in (".py", ".ipynb")]
    code = [path.read_text(encoding="utf-8") for path in examples]
    for path in (ROOT / "docs").rglob("*.md"):
        code += re.findall(r"```python.*?```", path.read_text(encoding="utf-8"), re.DOTALL)
    listed = re.findall(r"`(\w+)`", (ROOT / "docs" / "python.md").read_text(encoding="utf-8"))
    return frozenset((*re.findall(r"\.(\w+)", "\n".join(code)), *listed))


def errors(name: str, left_out: tuple[str, ...] = ()) -> list[str]:
    return [
        f"{name}: {message}"
        for code, message in validate(name)["errors"]
        if code in CODES and code not in left_out
    ]


@pytest.mark.parametrize("function", FUNCTIONS, ids=place)
def test_a_public_function_says_what_it_takes_and_returns(function: object) -> None:
    assert not errors(place(function))


def test_what_a_package_exports_is_described() -> None:
    packages = [import_module(name) for name in sorted(PACKAGES)]
    exported = [getattr(package, name) for package in packages for name in getattr(package, "__all__", ())]
    described = [thing for thing in exported if inspect.isfunction(thing)]
    assert len(described) > 50
    assert not [place(thing) for thing in described if not thing.__doc__]


@pytest.mark.parametrize("cls", CLASSES, ids=place)
def test_a_public_class_and_its_members_are_described(cls: type) -> None:
    # The fields of a class are its attributes, described as such or beneath each of them.
    # A member that no page names is for the other packages: its summary says what it gives.
    sections = ("PR01", "RT01", "YD01")
    found = errors(place(cls), ("PR01",))
    for name in members(cls):
        left_out = () if issubclass(cls, Device) or name in strangers_read() else sections
        found += errors(f"{place(cls)}.{name}", left_out)
    assert not found, "\n" + "\n".join(found)


@pytest.mark.parametrize("hook", HOOKS, ids=place)
def test_a_hook_says_what_a_driver_gets_and_gives(hook: Callable[..., Any]) -> None:
    assert not errors(place(hook))
    # A hook without a body returns nothing yet, so numpydoc does not ask what it will return.
    returns_a_value = inspect.signature(hook).return_annotation not in (None, "None")
    assert bool(FunctionDoc(hook)["Returns"]) == returns_a_value


def test_hooks_are_found() -> None:
    assert {hook.__name__ for hook in HOOKS} >= {"_open", "_setup", "_read", "_load", "_move_to", "_mount"}
