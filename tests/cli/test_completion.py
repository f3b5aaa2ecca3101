"""Completion in a shell: it can be installed, and knows the configurations that come with fpplab."""

from pathlib import Path

import pytest

from fpplab.cli.completion import names_of
from fpplab.core.config import shipped_configs
from tests.support.commands import Command


def completed(fpplab: Command, words: str, cwd: Path | None = None) -> list[str]:
    """What bash is offered for the last word of a command line."""
    given = {"_FPPLAB_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    return fpplab(cwd=cwd, env=given).out.split()


def test_the_script_is_shown(fpplab: Command) -> None:
    done = fpplab("--show-completion", "bash", env={"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"})
    assert done.code == 0, done.err
    assert "_FPPLAB_COMPLETE=complete_bash" in done.out
    assert "complete -o default -F _fpplab_completion fpplab" in done.out


def test_it_is_installed_for_this_user_alone(fpplab: Command, tmp_path: Path) -> None:
    done = fpplab(
        "--install-completion",
        "bash",
        env={"HOME": str(tmp_path), "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"},
    )
    assert done.code == 0, done.err
    installed = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert any("_FPPLAB_COMPLETE" in path.read_text() for path in installed)


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        ("fpplab scan --rig rig_", "rig"),
        ("fpplab check --plan plan_", "plan"),
        ("fpplab plan show plan_", "plan"),
        ("fpplab characterise --target target_", "target"),
        ("fpplab target target_", "target"),
        ("fpplab optimise stripes --study study_", "study"),
        ("fpplab optimise stripes --confirm rig_", "rig"),
        ("fpplab match --twin rig_", "rig"),
        ("fpplab verify --standard standard_", "standard"),
        ("fpplab dataset --scenes dataset_", "dataset"),
        ("fpplab dlp4500 build plan_", "plan"),
    ],
)
def test_names_that_come_with_fpplab_are_completed(fpplab: Command, words: str, kind: str) -> None:
    offered = completed(fpplab, words)
    assert offered == shipped_configs(kind)  # type: ignore[arg-type]
    assert offered


def test_only_what_begins_so_is_offered(fpplab: Command) -> None:
    assert completed(fpplab, "fpplab scan --rig rig_demo_") == ["rig_demo_quick"]
    assert completed(fpplab, "fpplab char") == ["characterise"]


def test_files_of_the_folder_are_offered_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("rig_mine.yaml", "plan_mine.yaml", "rig_mine.txt"):
        (tmp_path / name).write_text("")
    assert names_of("rig")("rig_m") == ["rig_matched", "rig_matched_still", "rig_mine.yaml"]
    assert names_of("rig")(f"{tmp_path}/rig") == [f"{tmp_path}/rig_mine.yaml"]
