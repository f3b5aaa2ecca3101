"""Families of documents whose members are found by themselves."""

import pickle
import sys
from abc import abstractmethod
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pydantic import Field, create_model

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.errors import ConfigError
from fpplab.core.tagged_union import TaggedUnion, import_members, registered_types


class Shape(Document):
    """A family."""

    kind: str

    @abstractmethod
    def area(self) -> float: ...


class Square(Shape):
    kind: Literal["square"] = "square"
    side: float = 1.0

    def area(self) -> float:
        return self.side**2


class Flat(Shape):
    """Abstract still, hence no member."""


class Disc(Flat):
    kind: Literal["disc"] = "disc"
    radius: float

    def area(self) -> float:
        return 3.0 * self.radius**2


class Drawing(Document):
    """A document with members in every place where one can stand."""

    one: Annotated[Shape, TaggedUnion(default="square")] = Square()
    named: dict[str, Annotated[Shape, TaggedUnion()]] = Field(default_factory=dict)
    listed: tuple[Annotated[Shape, TaggedUnion()], ...] = ()


def read(data: dict[str, Any]) -> Drawing:
    return config.validate(data, Drawing, "drawing.yaml")


def test_the_key_chooses_and_the_default_stands_for_a_missing_one() -> None:
    of = read({"one": {"side": 2.0}, "named": {"a": {"kind": "disc", "radius": 1.0}}})
    assert of == Drawing(one=Square(side=2.0), named={"a": Disc(radius=1.0)})
    assert of.one.area() == 4.0
    assert read({}).one == Square()


def test_members_are_dumped_whole_and_read_back() -> None:
    of = Drawing(one=Disc(radius=2.0), listed=(Square(), Disc(radius=1.0)))
    assert config.plain(of) == {
        "one": {"kind": "disc", "radius": 2.0},
        "named": {},
        "listed": [{"kind": "square", "side": 1.0}, {"kind": "disc", "radius": 1.0}],
    }
    assert read(config.plain(of)) == of
    assert pickle.loads(pickle.dumps(of)) == of


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"one": {"kind": "cube"}}, "'one' is {'kind': 'cube'}: must have a 'kind' of disc, square"),
        ({"one": {"kind": ["disc"]}}, "'one' is {'kind': ['disc']}: must have a 'kind' of disc, square"),
        ({"one": 5}, "'one' is 5: must have a 'kind' of disc, square"),
        ({"named": {"a": {"side": 1.0}}}, "'named.a' is {'side': 1.0}: must have a 'kind' of disc, square"),
        ({"one": {"kind": "disc"}}, "'one.radius' is missing"),
        (
            {"listed": [{"kind": "disc", "radius": "1"}]},
            "'listed[0].radius' is '1': should be a valid number; write 1",
        ),
        ({"one": {"kind": "disc", "radius": 1.0, "side": 1.0}}, "unknown key 'one.side'"),
    ],
)
def test_faults_name_the_field_and_the_kinds(data: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read(data)
    assert str(caught.value) == f"drawing.yaml: {said}"


def test_members_are_concrete_and_have_a_kind_each() -> None:
    assert registered_types(Shape) == {"disc": Disc, "square": Square}


def test_a_family_with_a_fault_is_refused_when_the_model_is_built() -> None:
    class Nameless(Document):
        pass

    class NoName(Nameless):
        pass

    class Twice(Document):
        kind: str

    class First(Twice):
        kind: Literal["same"] = "same"

    with pytest.raises(TypeError, match="NoName needs a field kind"):
        registered_types(Nameless)
    with pytest.raises(TypeError, match="default kind of Twice is 'other': must be of same"):

        class Wrong(Document):
            one: Annotated[Twice, TaggedUnion(default="other")]

    with pytest.raises(TypeError, match="First has no concrete subclass"):

        class Empty(Document):
            one: Annotated[First, TaggedUnion()]

    class Second(Twice):
        kind: Literal["same"] = "same"

    with pytest.raises(TypeError, match="First and Second are both of kind 'same'"):
        registered_types(Twice)


def test_a_new_module_in_a_package_joins_its_family(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the new file is written: neither the package nor the model that refers to the family changes."""
    package = tmp_path / "family_of_tests"
    package.mkdir()
    (package / "__init__.py").write_text(
        "from fpplab.core.tagged_union import import_members\nimport_members(__name__, __path__)\n"
    )
    (package / "base.py").write_text(
        "from fpplab.core.config import Document\nclass Family(Document):\n    kind: str\n"
    )
    member = (
        "from typing import Literal\nfrom family_of_tests.base import Family\n"
        "class {0}(Family):\n    kind: Literal['{1}'] = '{1}'\n"
    )
    (package / "old.py").write_text(member.format("Old", "old"))
    (package / "new.py").write_text(member.format("New", "new"))
    monkeypatch.syspath_prepend(tmp_path)
    try:
        import_members("family_of_tests", [str(package)])
        family = sys.modules["family_of_tests.base"].Family

        holder = create_model("Holder", __base__=Document, one=Annotated[family, TaggedUnion(default="old")])
        assert type(config.validate({"one": {"kind": "new"}}, holder, "test").one).__name__ == "New"
    finally:
        for name in [n for n in sys.modules if n.split(".")[0] == "family_of_tests"]:
            del sys.modules[name]
