"""Study files (study_*.yaml): what to search, within which bounds, for which objectives, and how."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import model_validator

from fpplab.core import config
from fpplab.core.file_kinds import naming_other_kinds
from fpplab.core.tagged_union import TaggedUnion, registered_types
from fpplab.optimisation import methods  # noqa: F401 - defines the members of SearchMethod
from fpplab.optimisation.problem import SearchProblem
from fpplab.optimisation.search_method import SearchMethod
from fpplab.patterns.plan import Plan, with_named_files


class Study(SearchProblem):
    """Schema of a study file; `load` replaces the name of the start's plan by the plan itself."""

    method: Annotated[SearchMethod, TaggedUnion()]
    """How the space is searched: one of the methods in `fpplab.optimisation.methods`, chosen by `kind`."""

    @model_validator(mode="after")
    def _method_fits(self) -> Study:
        several = len(self.objectives) > 1
        if several != self.method.several_objectives:
            raise ValueError(
                f"'method.kind' is '{self.method.kind}': with {len(self.objectives)} of 'objectives' it "
                f"must be {_method_kinds(several)}"
            )
        return self

    @classmethod
    def load(cls, path: Path | str) -> Study:
        file = config.find_config(path, "study")
        with naming_other_kinds(file, "study"):
            data = config.parse_yaml(config.read_text(file), file)
            if isinstance(data, dict):
                data = _resolve_plan_and_paths(data, file.parent)
            return config.validate(data, cls, file)


def _method_kinds(several_objectives: bool) -> str:
    kinds = [
        kind
        for kind, method in registered_types(SearchMethod).items()
        if issubclass(method, SearchMethod) and method.several_objectives is several_objectives
    ]
    return " or ".join(filter(None, [", ".join(kinds[:-1]), kinds[-1]]))


def _resolve_plan_and_paths(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    data = dict(data)
    if isinstance(data.get("board"), dict):
        data["board"] = {
            key: config.resolve_relative_to(value, folder) if key in ("target", "plan") else value
            for key, value in data["board"].items()
        }
    space = data.get("space")
    if isinstance(space, dict) and isinstance(space.get("alternatives"), list):
        alternatives = [with_named_files(each, folder) for each in space["alternatives"]]
        data["space"] = {**space, "alternatives": alternatives}
    if isinstance(data.get("start"), str):
        data["start"] = Plan.load(config.resolve_relative_to(data["start"], folder)).model_dump(mode="json")
    if isinstance(data.get("calibrations"), list):
        data["calibrations"] = [
            {**entry, "file": config.resolve_relative_to(entry["file"], folder)}
            if isinstance(entry, dict) and isinstance(entry.get("file"), str)
            else entry
            for entry in data["calibrations"]
        ]
    return data
