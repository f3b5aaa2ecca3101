"""Reference pages, written from the program itself: commands, files, names of the package, decisions."""

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer
from pydantic import BaseModel

import fpplab
from docs.generate.pages import DOCS
from docs.generate.tables import causes_page, faults_page, field_reports_page
from fpplab.calibration.model import CalibrationFile
from fpplab.cli.app import GROUPS
from fpplab.cli.every import app
from fpplab.comparison.acceptance.standard import Standard
from fpplab.devices.rig import RigFile
from fpplab.optimisation.study import Study
from fpplab.patterns.plan import Plan
from fpplab.targets.target import Target
from sim.dataset.scenes import SceneRanges
from sim.world.world import World

FILES: dict[str, tuple[str, type[BaseModel]]] = {
    "rig": ("which devices there are (`rig_*.yaml`)", RigFile),
    "plan": ("what to project (`plan_*.yaml`)", Plan),
    "target": ("a board of known points (`target_*.yaml`)", Target),
    "calibration": ("the models of both devices, as `fpplab characterise` writes them", CalibrationFile),
    "world": ("a simulated bench (`world_*.yaml`; [explained here](../twin.md))", World),
    "study": ("what `fpplab optimise` may change (`study_*.yaml`)", Study),
    "standard": ("ball bar and plane of `fpplab verify` (`standard_*.yaml`)", Standard),
    "scenes": ("ranges that `fpplab dataset` draws from (`dataset_*.yaml`)", SceneRanges),
}
HEAD = "<!-- Written by docs.generate.reference; not to be edited. -->\n\n"


def commands_page() -> str:
    """Write the page of all commands with their arguments and options.

    Returns
    -------
    str
        Markdown.
    """
    parts = [
        f"{HEAD}# Commands\n",
        "Every command takes `--json`: stdout is then exactly one JSON object. Exit codes: 0 done, 2 wrong "
        "input, 3 device, 4 data or a useless result, 5 calibration, 130 cancelled. Names of "
        "rigs, plans, targets and studies are those of `configs/`, or paths. Rare commands are shown below a "
        "group, and also work alone: "
        "`fpplab doctor` is `fpplab system doctor`.\n",
        _options(typer.main.get_command(app)),
    ]
    for name, command in every_command():
        parts.append(f"## fpplab {name}\n\n{_help(command)}\n\n{_options(command)}")
    return "\n".join(parts)


def every_command() -> Iterator[tuple[str, Any]]:
    """Give all commands that do something, each by its shortest name.

    Yields
    ------
    name : str
        As it is typed behind `fpplab`.
    command : object
        Of the command line's library.
    """
    yield from _below(typer.main.get_command(app), "")


def _below(group: Any, path: str) -> Iterator[tuple[str, Any]]:
    for name, command in sorted(group.commands.items()):
        if name in GROUPS.get(path.strip(), ()):
            continue  # it is also a command by itself
        if hasattr(command, "commands"):
            yield from _below(command, f"{path}{name} ")
        else:
            yield f"{path}{name}", command


def _help(command: Any) -> str:
    """A command's docstring; an example in a paragraph of its own becomes a block."""
    text = re.sub(r"[\b\f]", "", command.help or "")
    return re.sub(r"^Example: `([^`]+)`$", lambda found: f"```text\n{found[1]}\n```", text, flags=re.M)


def _options(command: Any) -> str:
    rows = [_row(parameter) for parameter in command.params if not getattr(parameter, "hidden", False)]
    return "| | | |\n|---|---|---|\n" + "\n".join(rows) + "\n" if rows else ""


def _row(parameter: Any) -> str:
    named = parameter.param_type_name == "option"
    name = ", ".join(f"`{word}`" for word in parameter.opts) if named else f"`{parameter.name.upper()}`"
    default = (
        ""
        if parameter.default in (None, False, ...) or callable(parameter.default)
        else f"`{parameter.default}`"
    )
    kind = "required" if parameter.required else default
    return f"| {name} | {_cell(kind)} | {_cell(getattr(parameter, 'help', '') or '')} |"


def _cell(text: str) -> str:
    return re.sub(r"\s*\n\s*", " ", text).replace("|", "\\|")


def files_page() -> str:
    """Write the page of all files that are written by hand, field by field.

    Returns
    -------
    str
        Markdown.
    """
    parts = [
        f"{HEAD}# Files\n\nYAML, of these kinds. A key that does not exist is refused with the one that was "
        "probably meant.\n"
    ]
    for kind, (words, model) in FILES.items():
        parts.append(f"## {kind.capitalize()} file\n\n{kind.capitalize()}: {words}.\n")
        schema = model.model_json_schema()
        named = schema.get("$defs", {})
        parts.append(_fields(schema, kind, named))
        for name, inner in sorted(named.items()):
            if inner.get("properties"):
                about = _cell(inner.get("description", "").partition("\n\n")[0])
                parts.append(
                    f"### {name} {{ #{_anchor(kind, name)} }}\n\n{about}\n\n{_fields(inner, kind, named)}"
                )
    return "\n".join(parts)


def _fields(schema: dict[str, Any], kind: str, named: dict[str, Any]) -> str:
    lines = ["| key | value | default | |", "|---|---|---|---|"]
    for key, field in schema.get("properties", {}).items():
        default = (
            "required"
            if key in schema.get("required", ())
            else f"`{field['default']}`"
            if "default" in field
            else ""
        )
        about = _cell(_about(field, named))
        lines.append(f"| `{key}` | {_type(field, kind, named)} | {_cell(default)} | {about} |")
    return "\n".join(lines) + "\n"


def _about(field: dict[str, Any], named: dict[str, Any]) -> str:
    """What is said of a field; a schema leaves it out where its model says the same of itself."""
    model = named.get(field.get("$ref", "").rpartition("/")[2], {})
    return str(field.get("description") or model.get("description", ""))


def _type(field: dict[str, Any], kind: str, named: dict[str, Any]) -> str:
    """What a field takes, in words, with a link where it has fields of its own."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        if not named[name].get("properties"):
            return _type(named[name], kind, named)
        return f"[{name}](#{_anchor(kind, name)})"
    for several in ("anyOf", "oneOf"):
        if several in field:
            return " or ".join(dict.fromkeys(_type(one, kind, named) for one in field[several]))
    if "enum" in field or "const" in field:
        return ", ".join(f"`{one}`" for one in field.get("enum", [field.get("const")]))
    if field.get("type") == "array":
        inner = field.get("prefixItems") or [field.get("items", {})]
        return "list of " + ", ".join(dict.fromkeys(_type(one, kind, named) for one in inner))
    words = {"null": "none", "object": "keys and values", "boolean": "true or false", "string": "text"}
    return words.get(field.get("type", ""), field.get("type", "any")) + _range(field)


def _range(field: dict[str, Any]) -> str:
    limits = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    found = [f"{sign} {field[key]}" for key, sign in limits.items() if key in field]
    return f" {', '.join(found)}" if found else ""


def _anchor(kind: str, name: str) -> str:
    return f"{kind}-{re.sub(r'[^a-z0-9]+', '-', name.lower()).strip('-')}"


def api_page() -> str:
    """Write the page of the public names.

    Returns
    -------
    str
        Markdown with directives that put the docstrings in.
    """
    parts = [
        f"{HEAD}# Python names\n\nWhat `from fpplab import …` gives. These names and their signatures stay; "
        "names of the packages below may change between versions.\n"
    ]
    for name in sorted(fpplab.__all__):
        if name != "__version__":
            parts.append(f"::: {public_path(name)}\n")
    return "\n".join(parts)


def public_path(name: str) -> str:
    """Tell where a public name is defined.

    Parameters
    ----------
    name : str
        One of `fpplab.__all__`.

    Returns
    -------
    str
        Its dotted path.
    """
    thing = getattr(fpplab, name)
    module = importlib.import_module(thing.__module__)
    return f"{module.__name__}.{thing.__qualname__}"


def decisions_page() -> str:
    """Write the list of decision records.

    Returns
    -------
    str
        Markdown.
    """
    folder = DOCS / "decisions"
    current = [page for page in sorted(folder.glob("*.md")) if page.name != "index.md"]
    lines = [f"{HEAD}# Decisions\n\nWhy something is as it is, one page for each topic.\n"]
    lines += [f"* [{_title(page)}]({page.name})" for page in current]
    lines.append("\n## Archive\n\nThe records in order of their dates; later ones replace earlier ones.\n")
    lines += [
        f"* [{_title(page)}](archive/{page.name})" for page in sorted((folder / "archive").glob("*.md"))
    ]
    return "\n".join(lines) + "\n"


def _title(page: Path) -> str:
    """Heading of a page, without its number."""
    return re.sub(r"^# (\d+\. )?", "", page.read_text(encoding="utf-8").partition("\n")[0])


PAGES = {
    "reference/commands.md": commands_page,
    "reference/files.md": files_page,
    "reference/api.md": api_page,
    "reference/causes.md": causes_page,
    "reference/faults.md": faults_page,
    "reference/field-reports.md": field_reports_page,
    "decisions/index.md": decisions_page,
}
"""Generated pages by their path in the documentation."""
