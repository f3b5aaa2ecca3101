"""Families of configuration models: each subclass of an abstract base is a member, named by its field `kind`.

Members have to be defined before the first model that refers to the family; where each has a module of its
own, the package's ``__init__`` calls `import_members`.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module
from inspect import isabstract
from pkgutil import iter_modules
from typing import Any, TypeVar

from pydantic import BaseModel, GetCoreSchemaHandler
from pydantic_core import core_schema

T = TypeVar("T")


@dataclass(frozen=True)
class TaggedUnion:
    """Pydantic annotation of an abstract base: one of its concrete subclasses, chosen by `kind`."""

    default: str | None = None  # kind of a mapping without the key ``kind``; None where the key must be given

    def __get_pydantic_core_schema__(
        self, source: type[BaseModel], handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        members = registered_types(source)
        if not members:
            raise TypeError(f"{source.__name__} has no concrete subclass to choose by 'kind'")
        if self.default is not None and self.default not in members:
            raise TypeError(
                f"the default kind of {source.__name__} is '{self.default}': must be of {', '.join(members)}"
            )

        def kind_of(value: Any) -> str | None:
            kind = (
                value.get("kind", self.default) if isinstance(value, dict) else getattr(value, "kind", None)
            )
            return kind if isinstance(kind, str) and kind in members else None

        return core_schema.tagged_union_schema(
            {kind: handler.generate_schema(member) for kind, member in members.items()},
            kind_of,
            custom_error_type="kind",
            custom_error_message=f"must have a 'kind' of {', '.join(members)}",
        )


def registered_types(base: type[BaseModel]) -> dict[str, type[BaseModel]]:
    members: dict[str, type[BaseModel]] = {}
    for member in concrete_subclasses(base):
        field = member.model_fields.get("kind")
        kind = None if field is None else field.default
        if not isinstance(kind, str):
            raise TypeError(f"{member.__name__} needs a field kind: Literal['name'] = 'name'")
        if members.setdefault(kind, member) is not member:
            raise TypeError(f"{members[kind].__name__} and {member.__name__} are both of kind '{kind}'")
    return dict(sorted(members.items()))


def concrete_subclasses(base: type[T]) -> list[type[T]]:
    subclasses: dict[type[T], None] = {}
    waiting = [base]
    while waiting:
        new = [cls for cls in waiting.pop().__subclasses__() if cls not in subclasses]
        subclasses.update(dict.fromkeys(new))
        waiting.extend(new)
    return [cls for cls in subclasses if not isabstract(cls)]


def import_members(package_name: str, package_path: Iterable[str]) -> None:
    # Called in the package's ``__init__`` as ``import_members(__name__, __path__)``. Packages inside it are
    # imported too, but not searched further.
    for module in sorted(iter_modules(package_path), key=lambda info: info.name):
        import_module(f"{package_name}.{module.name}")
