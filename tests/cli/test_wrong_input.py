"""What people type that is wrong, and what the program answers: the right cause, and what to do next.

`python -m tests.cli.test_wrong_input` writes the answers of today into the table, to be reviewed by hand.
"""

import contextlib
import shlex
import tempfile
from pathlib import Path
from typing import Any

import pytest
import yaml

from fpplab.artefacts import artefact_types
from fpplab.core.plugins import EMULATORS, plugin_names
from tests.cli.refusals import say
from tests.support.file_kinds import make_files

TABLE = Path(__file__).with_name("wrong_input.yaml")
CASES = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
COMMANDS = {
    "plan": "plan show wrong.yaml --rig rig.yaml",
    "rig": "plan show plan.yaml --rig wrong.yaml",
    "target": "target wrong.yaml --out o/t.pdf",
}
"""How each kind of file is used."""


def answer_to(words: str) -> str:
    """The answer, with a word for each list of names that a plug-in lengthens."""
    artefacts, (*others, last) = [*artefact_types()], sorted(artefact_types())
    lists = {
        "ARTEFACTS": (", ".join(artefacts), f"{', '.join(others)} or {last}"),
        "EMULATORS": (", ".join(plugin_names(EMULATORS)),),
    }
    answer = say(shlex.split(words))
    for word, shown in lists.items():
        for names in shown:
            answer = answer.replace(names, word)
    return answer


def say_of(case: dict[str, str]) -> str:
    """The answer to a file with one line written wrongly."""
    text = Path(f"{case['file']}.yaml").read_text(encoding="utf-8")
    assert case["line"] in text, case
    wrong = text.replace(case["line"], case["written"], 1)
    Path("wrong.yaml").write_text(wrong, encoding="utf-8")
    return say(COMMANDS[case["file"]].split())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("input")
    make_files(path)
    return path


@pytest.mark.whole
def test_wrong_words_are_answered_as_reviewed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    assert {words: answer_to(words) for words in CASES["words"]} == CASES["words"]


@pytest.mark.whole
def test_wrong_lines_are_answered_as_reviewed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    for case in CASES["lines"]:
        assert say_of(case) == case["answer"], case


def test_no_wrong_input_is_taken() -> None:
    answers = [*CASES["words"].values(), *(case["answer"] for case in CASES["lines"])]
    assert len(answers) >= 150
    for answer in answers:
        assert answer[:2] in ("2 ", "4 "), answer
        assert "─" not in answer, answer


def main() -> None:
    """Replace the answers of the table."""
    table: dict[str, Any] = CASES
    with tempfile.TemporaryDirectory() as path, contextlib.chdir(path):
        make_files(Path(path))
        table["words"] = {words: answer_to(words) for words in table["words"]}
        for case in table["lines"]:
            case["answer"] = say_of(case)
    text = yaml.safe_dump(table, sort_keys=False, width=10_000, allow_unicode=True)
    TABLE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
