"""YAML documents with a schema: read strictly, refused in one sentence, written back."""

import ast
import codecs
import inspect
import json
import logging
import re
from contextlib import nullcontext, suppress
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from textwrap import dedent
from typing import Annotated, Any, Literal, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, Field, GetJsonSchemaHandler, ValidationError
from yaml.representer import SafeRepresenter

from fpplab.core.checksums import check_recorded
from fpplab.core.errors import ConfigError
from fpplab.core.file_kinds import WantedKind, naming_other_kinds
from fpplab.core.files import no_such_file, read_bounded
from fpplab.core.strict_yaml import load_yaml
from fpplab.core.units import corrected_number

_log = logging.getLogger(__name__)

MAX_TEXT_BYTES = 8_000_000  # greatest size in bytes of a text file (chosen)
MAX_FAULTS = 5  # faults of a file that one message reports (chosen)


class Document(BaseModel):
    """Base of everything that is read from YAML: strict, frozen, no unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema).get("properties", {})
        for name, text in field_descriptions(cls).items():
            key = cls.model_fields[name].alias or name if name in cls.model_fields else name
            if key in properties:
                properties[key].setdefault("description", text)
        return schema


def field_descriptions(model: type[Document]) -> dict[str, str]:
    """Read the sentences below the fields of a model in its source."""
    # Not by `use_attribute_docstrings`: it reads them of every model whenever the program starts.
    texts: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if not issubclass(base, Document) or base is Document:
            continue
        for source in vars(base).get("described_by", ()):
            texts |= field_descriptions(source)
        with suppress(OSError, TypeError):  # made by `create_model`: no source, but perhaps `described_by`
            (definition,) = ast.parse(dedent(inspect.getsource(base))).body
            for field, text in pairwise(getattr(definition, "body", ())):
                match field, text:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(ast.Constant(str(words))):
                        texts[name] = inspect.cleandoc(words)
    return texts


D = TypeVar("D", bound=Document)

Positive = Annotated[float, Field(gt=0)]  # a number above zero


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """Quotes what would be read back as something else: a serial number 21e7, an odd line break."""


def _word(dumper: SafeRepresenter, word: str) -> yaml.ScalarNode:
    odd = any(mark in word for mark in "\x85\u2028\u2029\ufeff")
    return dumper.represent_scalar("tag:yaml.org,2002:str", word, style='"' if odd else None)


_Dumper.add_representer(str, _word)
_Dumper.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d[\d_]*)(\.\d*)?[eE][-+]?\d+$"), list("-+0123456789")
)


_YAML_ADVICE = {
    "could not find expected ':'": "is no 'name: value', which has a colon and a blank between the two",
    "mapping values are not allowed": "is indented unlike the line before, or has a second colon: quote it",
    "found character '\\t'": "begins with a tab; indent by blanks",
}


def parse_yaml(text: str, source: Path | str) -> Any:
    try:
        return load_yaml(text)
    except yaml.MarkedYAMLError as error:
        problem = error.problem or "not readable as YAML"
        if "<stream end>" in problem:
            raise ConfigError(f"{source}: ends within a list or mapping; it seems to be cut off") from error
        advice = next((advice for known, advice in _YAML_ADVICE.items() if problem.startswith(known)), None)
        # A line that is no pair is noticed in the one behind it.
        mark = error.context_mark if advice and error.context_mark else error.problem_mark
        line = f" line {mark.line + 1}" if mark else ""
        raise ConfigError(f"{source}{line}: {advice or problem}") from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"{source}: not readable as YAML ({reason})") from error


def read_text(path: Path) -> str:
    """Read a text file of this or another system: UTF-8, or UTF-16 with a byte order mark."""
    try:
        content = read_bounded(path, MAX_TEXT_BYTES)
        check_recorded(path, content)
        is_wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = content.decode("utf-16" if is_wide else "utf-8-sig")
        if "\0" in text:
            raise ConfigError(f"{path}: is not a text file in UTF-8; is it UTF-16 without its mark?")
        return text.replace("\r\n", "\n").replace("\r", "\n")
    except FileNotFoundError:
        raise ConfigError(no_such_file(path)) from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not a text file in UTF-8") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error


def load_document(path: Path | str, model: type[D], kind: WantedKind | None = None) -> D:
    """Read one YAML file as a document; a file of another kind is named where it is said which is wanted."""
    path = Path(path)
    with naming_other_kinds(path, kind) if kind else nullcontext():
        return validate(parse_yaml(read_text(path), path), model, path)


def validate(data: Any, model: type[D], source: Path | str) -> D:
    if not isinstance(data, dict):
        raise ConfigError(f"{source}: expected a mapping of fields, found {_shown(data)}")
    try:
        # As JSON, because strict JSON still takes a list for a tuple and a word for a choice.
        return model.model_validate_json(json.dumps(data, default=str))
    except ValidationError as error:
        raise ConfigError(f"{source}: {describe(error, data, model)}") from error


def describe(error: ValidationError, data: Any = None, model: type[Document] | None = None) -> str:
    # A misspelt key is both unknown and missing: what the operator wrote comes first.
    details: list[Any] = sorted(error.errors(), key=lambda detail: detail["type"] != "extra_forbidden")
    # A list whose entries are wrong seems too short as well, for it counts the right ones alone.
    parents = {d["loc"][:depth] for d in details for depth in range(len(d["loc"]))}
    details = [d for d in details if d["type"] != "too_short" or d["loc"] not in parents]
    # Defaults that depend on other fields are not even tried where one of those is wrong.
    details = [d for d in details if d["type"] != "default_factory_not_called"]
    if data is not None:
        details = [_fault_in_document(detail, data) for detail in details]
    unknown = [_field(d["loc"]) for d in details if d["type"] == "extra_forbidden"]
    messages = [_fault(d) for d in details if d["type"] != "extra_forbidden" or len(unknown) == 1]
    if len(unknown) > 1:
        messages.insert(0, "unknown keys " + ", ".join(f"'{key}'" for key in unknown))
    if unknown and model is not None and (meant := _meant_key(unknown[0], model)):
        messages[0] += f" (did you mean '{meant}'?)"
    shown = list(dict.fromkeys(messages))  # one look at the file corrects them all
    remainder = f" (and {len(shown) - MAX_FAULTS} more)" if len(shown) > MAX_FAULTS else ""
    return "; ".join(shown[:MAX_FAULTS]) + remainder


_UNIT = re.compile(r"_(s|ms|us|mm|cm|m|um|px|deg|db|hz)$")


def _meant_key(field: str, model: type[Document]) -> str | None:
    word, names = field.rpartition(".")[2], set[str]()
    remaining: list[Any] = [model.model_json_schema()]
    while remaining:
        part = remaining.pop()
        if isinstance(part, dict):
            names.update(part["properties"] if isinstance(part.get("properties"), dict) else ())
            remaining += part.values()
        elif isinstance(part, list):
            remaining += part
    if word in names:  # which stands in another place
        return None
    plain = {_UNIT.sub("", name): name for name in sorted(names)}  # exposure_ms for exposure_s
    plain |= {name: name for name in sorted(names)}
    if len(word) > 2 and (begun := [name for name in sorted(names) if name.startswith(word.lower())]):
        return plain.get(word.lower(), begun[0])
    meant = get_close_matches(_UNIT.sub("", word.lower()), plain, n=1, cutoff=0.75)
    return plain[meant[0]] if meant else None


def _fault(detail: Any) -> str:
    field = _field(detail["loc"])
    if detail["type"] == "extra_forbidden":
        return f"unknown key '{field}'"
    if detail["type"] == "missing":
        return f"'{field}' is missing"
    message = detail["msg"].removeprefix("Value error, ").removeprefix("Input ")
    message = message.replace("a valid array", "a list, in brackets").replace("an object", "a mapping, or {}")
    if detail["type"] == "value_error" and not field:
        return str(message)
    if detail["type"] == "value_error" and isinstance(detail["input"], dict):
        return f"in '{field}' {message}"  # which names the field inside
    return f"'{field}' is {_shown(detail['input'])}: {message}{_correction(field, detail)}"


def _correction(field: str, detail: Any) -> str:
    value, kind = detail["input"], detail["type"]
    if kind.startswith("string") and isinstance(value, int | float) and not isinstance(value, bool):
        return f"; write it in quotes, '{value}'"
    if kind.startswith("literal") and isinstance(value, str):
        choices = re.findall(r"'([^']+)'", detail["ctx"]["expected"])
        close = get_close_matches(value.lower(), choices, n=1)
        return f"; did you mean '{close[0]}'?" if close else ""
    if kind.startswith("tuple") and isinstance(value, str):
        numbers = re.findall(r"\d+(?:\.\d+)?", value)
        return f"; write [{', '.join(numbers)}]" if len(numbers) > 1 else ""
    if kind.startswith("int") and isinstance(value, float) and value.is_integer():
        return f"; write {int(value)}"
    if isinstance(value, str) and kind.startswith(("float", "int")):
        unit = field.rpartition("_")[2].replace("um", "µm").rstrip("]0123456789[")
        corrected = corrected_number(value, unit)
        return f"; write {corrected}" if corrected else ""
    return ""


def _fault_in_document(detail: Any, data: Any) -> dict[str, Any]:
    """Locate a fault in the document, without the names of which of several models was tried."""
    place: list[int | str] = []
    for part in detail["loc"]:
        inside = data if isinstance(data, dict) else dict(enumerate(data)) if isinstance(data, list) else {}
        if part in inside:
            data = inside[part]
            place.append(part)
    if detail["type"] == "missing":
        place.append(detail["loc"][-1])
    return {**detail, "loc": tuple(place)}


def _field(loc: tuple[int | str, ...]) -> str:
    text = ""
    for part in loc:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def dump(document: Document) -> str:
    return to_yaml(plain(document))


def plain(document: Document) -> dict[str, Any]:
    data: dict[str, Any] = document.model_dump(mode="json", exclude_none=True)
    return data


def to_yaml(data: Any) -> str:
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)


def resolve_relative_to(name: str, folder: Path) -> str:
    path = folder / name
    return str(path.resolve()) if name and path.exists() else name


def portable_name(name: str) -> str:
    # What comes with fpplab is written by its name alone, which another installation knows too.
    path = Path(name)
    return path.name if path.parent in (_PACKAGE, _CHECKOUT) else name


ConfigKind = Literal["calibration", "dataset", "plan", "rig", "standard", "study", "target", "world"]
"""What a configuration describes: the first word in the names of those that come with fpplab."""

_PACKAGE, _CHECKOUT = (Path(__file__).parents[up] / "configs" for up in (1, 2))


def shipped_configs(kind: ConfigKind | None = None) -> list[str]:
    names = {path.stem for folder in (_PACKAGE, _CHECKOUT) for path in folder.glob("*.yaml")}
    return sorted(name for name in names if kind is None or name.split("_")[0] == kind)


def find_config(name: str | Path, kind: ConfigKind | None = None) -> Path:
    # Looks at the path itself, then in the installed package, then next to the checkout.
    path = Path(name)
    if path.exists():
        return path
    if path.parent in (Path(), Path("configs")):
        for folder in (_PACKAGE, _CHECKOUT):
            for candidate in (folder / path.name, folder / f"{path.name}.yaml"):
                if candidate.is_file():
                    _log.debug("%s is %s", name, candidate)
                    return candidate
    raise ConfigError(f"{name}: there is no such file; {_suggestion(path, kind)}")


def _suggestion(path: Path, kind: ConfigKind | None) -> str:
    shipped = shipped_configs(kind)
    if kind is None:
        shipped = [name for name in shipped if name.split("_")[0] == path.name.split("_")[0]] or shipped
    others = {other for other in get_args(ConfigKind) if other != kind}
    files = [p for p in sorted(path.parent.glob("*.yaml")) if p.name.split("_")[0] not in others or not kind]
    nearby = {p.stem: str(p) for p in files}
    closest = get_close_matches(path.name.removesuffix(".yaml"), [*nearby, *shipped], n=1, cutoff=0.7)
    question = f"did you mean {nearby.get(closest[0], closest[0])}? " if closest else ""
    return f"{question}fpplab brings {', '.join(shipped)}"
