"""What the program answers to words that it does not know, and to questions about itself."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner

from fpplab import Calibration, __version__
from fpplab.cli.advice import OPTION_SYNONYMS, SYNONYMS, unknown_command, unknown_option
from fpplab.cli.app import GROUPS, Commands
from fpplab.cli.every import app
from fpplab.cli.lists import global_first
from fpplab.core.config import find_config, shipped_configs
from fpplab.core.errors import ConfigError
from tests.support.commands import Command

COMMANDS = get_command(app).commands  # type: ignore[attr-defined]


def paths(group: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Every command and sub-command, by the words that call it."""
    yield above
    for name, command in getattr(group, "commands", {}).items():
        yield from paths(command, (*above, name))


PATHS = list(paths(get_command(app)))


def refusal(*words: str) -> str:
    """The sentence with which the program refuses words."""
    result = CliRunner().invoke(app, list(words), prog_name="fpplab")
    assert isinstance(result.exception, ConfigError), result.output
    return str(result.exception)


@pytest.mark.whole
def test_version_is_printed(fpplab: Command) -> None:
    done = fpplab("--version")
    assert (done.code, done.out, done.err) == (0, f"fpplab {__version__}\n", "")


@pytest.mark.whole_after(2, nightly=8)
@pytest.mark.parametrize("path", PATHS, ids=lambda path: " ".join(path) or "fpplab")
def test_h_is_help(path: tuple[str, ...]) -> None:
    long, short = (CliRunner().invoke(app, [*path, option]) for option in ("--help", "-h"))
    assert (short.exit_code, short.output) == (0, long.output)
    assert "Usage:" in short.output


def test_sub_commands_are_among_those_asked_for_help() -> None:
    assert {("plan", "show"), ("camera", "save"), ("dlp4500", "build")} <= set(PATHS)


def options(group: Any) -> Iterator[tuple[str, Any]]:
    """Name and default of every option of all commands."""
    for command in getattr(group, "commands", {}).values():
        yield from ((one.opts[0], one.default) for one in command.params)
        yield from options(command)


@pytest.mark.parametrize(
    ("name", "default"), [("--json", False), ("--force", False), ("--dry-run", False), ("--echo", True)]
)
def test_an_option_has_the_same_default_in_all_commands(name: str, default: bool) -> None:
    found = [given for one, given in options(get_command(app)) if one == name]
    assert found
    assert set(found) == {default}


def test_a_synonym_is_answered_with_the_command(fpplab: Command) -> None:
    done = fpplab("calibrate", "--rig", "rig_demo", "--json")
    assert done.code == 2
    assert done.json == {
        "error": "there is no command 'calibrate'; did you mean `fpplab characterise` (Calibrate camera and "
        "projector, or correct a calibration)?",
        "exit_code": 2,
    }
    assert done.err == f"fpplab: {done.json['error']}\n"


@pytest.mark.parametrize(
    ("word", "command"),
    [
        ("calibration", "characterise"), ("capture", "scan"), ("measure", "scan"), ("acquire", "scan"),
        ("triangulate", "reconstruct"), ("unwrap", "decode"), ("simulate", "demo"), ("optimize", "optimise"),
        ("evaluate", "compare"), ("save", "export"), ("save", "reconstruct"), ("e57", "export"),
        ("show", "view"), ("environment", "doctor"),
        ("Calibrate", "characterise"), ("version", "--version"), ("help", "--help"),
        ("scna", "scan"), ("calibarte", "characterise"), ("recon", "reconstruct"),
        ("characterize", "characterise"),
    ],
)  # fmt: skip
def test_words_that_are_no_commands_name_the_right_one(word: str, command: str) -> None:
    said = refusal(word)
    assert said.startswith(f"there is no command '{word}'; ")
    assert f"`fpplab {command}" in said


@pytest.mark.parametrize(
    ("word", "rule"), [("0", "must be greater than or equal to 1"), ("near", "must be a valid number in mm")]
)
def test_a_wrong_argument_is_shown_as_it_was_written(word: str, rule: str) -> None:
    program = typer.Typer(cls=Commands)
    program.callback()(lambda: None)

    @program.command("aim")
    def aim(distance: Annotated[float, typer.Argument(help="Distance in mm.", min=1.0)]) -> None:
        raise AssertionError(distance)

    refused = CliRunner().invoke(program, ["aim", word]).exception
    assert isinstance(refused, ConfigError)
    assert str(refused) == f"DISTANCE is '{word}': {rule}"


def test_a_word_like_nothing_is_sent_to_the_list() -> None:
    assert refusal("xyzzy") == "there is no command 'xyzzy'; `fpplab --help` lists those that there are"


def test_commands_of_commands_are_suggested_too() -> None:
    assert refusal("plan", "shwo") == "there is no command 'plan shwo'; did you mean `fpplab plan show`?"
    assert "`fpplab dlp4500 build`" in refusal("dlp4500", "biuld")
    assert "did you mean" not in refusal("plan", "calibrate")  # a synonym of a command that is not below plan


def test_synonyms_lead_to_commands_and_are_none() -> None:
    assert {command for commands in SYNONYMS.values() for command in commands} <= set(COMMANDS)
    doubled = set(SYNONYMS) & set(COMMANDS)
    assert not doubled, "people mean another command by this name: give the new one another"


def test_synonyms_of_options_lead_to_options() -> None:
    params = [param for command in COMMANDS.values() for param in command.params]
    there = {name for param in params for name in (*param.opts, *param.secondary_opts)}
    assert {option for options in OPTION_SYNONYMS.values() for option in options} <= there


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("scan", "--output", "x"), "`fpplab scan` has no option --output; it is --out"),
        (("target", "--output", "x"), "`fpplab target` has no option --output; it is --out"),
        (("scan", "--calibratio"), "`fpplab scan` has no option --calibratio; did you mean --calibration?"),
        (("characterise", "--board", "x"), "`fpplab characterise` has no option --board; it is --target"),
        (("plan", "show", "--rgi", "x"), "`fpplab plan show` has no option --rgi; did you mean --rig?"),
        (("devices", "--zoom", "x"), "`fpplab devices` has no option --zoom; see `fpplab devices --help`"),
        (("--verison",), "`fpplab` has no option --verison; did you mean --version?"),
    ],
)  # fmt: skip
def test_an_unknown_option_names_the_right_one(words: tuple[str, ...], said: str) -> None:
    assert refusal(*words) == said


def test_sentences_name_the_program_that_was_called() -> None:
    assert unknown_command("fpplab plan", "x", {"show": "Show a plan."}).endswith(
        "`fpplab plan --help` lists those that there are"
    )
    assert (
        unknown_option("fpplab scan", "-q", ["--out"])
        == "`fpplab scan` has no option -q; see `fpplab scan --help`"
    )


@pytest.mark.parametrize(
    ("kind", "typo", "meant"),
    [
        ("rig", "rig_dmeo", "rig_demo"),
        ("plan", "plan_papre.yaml", "plan_paper"),
        ("target", "taget_paper", "target_paper"),
        ("study", "study_strips", "study_stripes"),
        ("world", "world_hiden", "world_hidden"),
        ("standard", "standart_demo", "standard_demo"),
    ],
)
def test_a_typo_in_a_name_suggests_names_of_its_kind(kind: Any, typo: str, meant: str) -> None:
    with pytest.raises(ConfigError) as caught:
        find_config(typo, kind)
    said = str(caught.value)
    assert said.startswith(f"{typo}: there is no such file; did you mean {meant}? fpplab brings ")
    suggested = set(re.findall(r"\w+_\w+", said.partition("such file;")[2]))
    assert suggested == set(shipped_configs(kind))
    assert all(name.startswith(f"{kind}_") for name in suggested)


def test_files_beside_are_suggested_but_those_of_other_kinds(tmp_path: Path) -> None:
    for name in ("bench_left.yaml", "plan_left.yaml"):
        (tmp_path / name).write_text("")
    with pytest.raises(ConfigError, match=r"did you mean \S*bench_left\.yaml\?"):
        find_config(tmp_path / "bench_letf.yaml", "rig")
    with pytest.raises(ConfigError) as caught:
        find_config(tmp_path / "plan_letf", "rig")
    assert "did you mean" not in str(caught.value)


def test_commands_ask_for_their_kind(fpplab: Command, tmp_path: Path) -> None:
    done = fpplab("plan", "show", "plan_paper", "--rig", "rig_dmeo", "--json")
    assert done.code == 2
    assert "did you mean rig_demo?" in done.json["error"]
    assert "plan_" not in done.json["error"]
    done = fpplab("target", "target_papr", "--out", tmp_path / "x.pdf", "--json")
    assert done.code == 2
    assert "did you mean target_paper?" in done.json["error"]
    assert "rig_" not in done.json["error"]


def test_a_calibration_is_suggested_among_the_files_beside(tmp_path: Path) -> None:
    (tmp_path / "calibration.yaml").write_text("camera: {}")
    with pytest.raises(
        ConfigError, match=r"calibratio.yaml: there is no such file; did you mean .*calibration.yaml\?$"
    ):
        Calibration.load(tmp_path / "calibratio.yaml")
    with pytest.raises(ConfigError, match=r"there is no such file$"):
        Calibration.load(tmp_path / "other.yaml")


def test_options_of_the_program_may_follow_the_command() -> None:
    assert global_first(["scan", "--out", "x", "-v", "--log", "f"]) == [
        "-v",
        "--log",
        "f",
        "scan",
        "--out",
        "x",
    ]
    assert global_first(["scan", "--log=f", "--", "-v"]) == ["--log=f", "scan", "--", "-v"]
    assert global_first(["scan", "--log"]) == ["scan", "--log"]


def test_all_groups_fit_one_screen_and_rare_commands_work_by_both_names() -> None:
    """33 lines of 80 columns; what a group shows is the command of the same name, so that scripts go on."""
    said = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "80", "TERMINAL_WIDTH": "80"}).output
    lines = len(said[said.index("─ Start here") :].splitlines())
    assert 20 < lines <= 33, "the help is full: give a command a group of fpplab.cli.app.GROUPS for a heading"
    hidden = {name for name, command in COMMANDS.items() if command.hidden}
    assert {"export", "exposure", "doctor", "camera", "dataset"} <= hidden
    assert sorted(hidden) == sorted(name for names in GROUPS.values() for name in names)
    for group, names in GROUPS.items():
        for name in names:
            alone, inside = COMMANDS[name], COMMANDS[group].commands[name]
            assert (alone.hidden, inside.hidden) == (True, False)
            assert (alone.help, [each.opts for each in alone.params]) == (
                inside.help, [each.opts for each in inside.params],
            )  # fmt: skip


def test_help_fits_the_code_page_of_a_windows_console() -> None:
    root = get_command(app)
    for path in PATHS:
        command = root
        for word in path:
            command = command.commands[word]  # type: ignore[attr-defined]
        texts = [command.help, *(getattr(each, "help", None) for each in command.params)]
        assert all((text or "").encode("cp437") for text in texts if text), path
