"""Configuration is read strictly, and every refusal is one sentence that helps."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.core import config, errors
from fpplab.core.config import Document
from fpplab.core.errors import ConfigError


class Lens(Document):
    """An example."""

    focal_mm: float
    coated: bool = False


class Body(Document):
    """An example with another inside."""

    name: str
    lens: Lens
    sizes: tuple[int, int] = (4, 3)


def load(text: str, tmp_path: Path) -> Body:
    path = tmp_path / "body.yaml"
    path.write_text(text)
    return config.load_document(path, Body)


def test_a_good_file(tmp_path: Path) -> None:
    body = load("name: a\nlens: {focal_mm: 35}\nsizes: [2, 1]", tmp_path)
    assert body == Body(name="a", lens=Lens(focal_mm=35.0), sizes=(2, 1))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("name: a\nlens: {focal_mm: 35}\ncolour: red", "unknown key 'colour'"),
        ("name: a\nlens: {focal_mm: 35, f: 2}", "unknown key 'lens.f'"),
        ("name: a", "'lens' is missing"),
        ("name: a\nlens: {}", "'lens.focal_mm' is missing"),
        ("name: 1\nlens: {focal_mm: 35}", "'name' is 1: should be a valid string"),
        ("name: a\nlens: {focal_mm: '35'}", "'lens.focal_mm' is '35': should be a valid number"),
        ("name: a\nlens: {focal_mm: true}", "'lens.focal_mm' is True: should be a valid number"),
        ("name: a\nlens: {focal_mm: 35, coated: 1}", "'lens.coated' is 1: should be a valid boolean"),
        ("name: a\nlens: {focal_mm: 35}\nsizes: [4, 3.5]", r"'sizes\[1\]' is 3.5: "),
        ("name: a\nlens: {focal_mm: 35}\nsizes: [4]", r"'sizes\[1\]' is missing"),
        ("name: a\nlens: {focal_mm: 35}\nsizes: [4, 3, 2]", r"'sizes' is \[4, 3, 2\]: "),
        ("name: a\nlens: 35", "'lens' is 35: "),
        ("name:\nlens: {focal_mm: 35}", "'name' is None: should be a valid string"),
        (
            "nam: a\nlens: {}",
            "unknown key 'nam' .did you mean 'name'.*; 'name' is missing; 'lens.focal_mm' is missing$",
        ),
        ("nam: a\nlens: {f: 2}\nx: 1", "unknown keys 'lens.f', 'nam', 'x'; 'name' is missing; "),
        ("name: a\nlens: {focal_mm: 35, f: 2}\nx: 1", "unknown keys 'lens.f', 'x'$"),
        ("- name", r"expected a mapping of fields, found \['name'\]"),
        ("", "expected a mapping of fields, found None"),
        ("just words", "expected a mapping of fields, found 'just words'"),
    ],
)
def test_a_wrong_field_is_named(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=rf"^\S*body\.yaml: {complaint}") as caught:
        load(text, tmp_path)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("name: a\nname: b", "line 2: key 'name' is given twice"),
        ("name: a\nlens:\n  focal_mm: 1\n  focal_mm: 2", "line 4: key 'focal_mm' is given twice"),
        ("name: [a", ": ends within a list or mapping; it seems to be cut off"),
        ("name: a\n\tlens: b", "line 2: begins with a tab; indent by blanks"),
        ("? [1, 2]\n: 3", "line 1: a key is not a word"),
        ("name: &n [*n]", "line 1: an alias refers to a value that it is part of"),
        ("name: !!python/object/apply:os.getcwd []", "line 1: the tag '.*os.getcwd' is not allowed"),
        ("name: !!bool maybe", "line 1: the tag '.*bool' is not allowed"),
        ("a: 1\nname: !!map [x]", "line 2: the tag '.*map' is not allowed"),
        ("name: !!binary aGk=", "line 1: the tag '.*binary' is not allowed"),
        ("name: " + 60 * "{a: " + "1" + 60 * "}", "line 1: there are more than 50 mappings"),
        ("name: " + 100_000 * "[", "line 1: there are more than 50 mappings"),
        ("name: '" + 2_000_001 * "a" + "'", ": not readable as YAML .it has 20000.. characters, more than"),
        ("name: a\x07", ": not readable as YAML"),
    ],
)
def test_what_is_not_yaml_is_refused_with_its_line(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=rf"body\.yaml ?{complaint}".replace("[1", r"\[1")) as caught:
        load(text, tmp_path)
    assert "\n" not in str(caught.value)


def test_what_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"body\.yaml: there is no such file"):
        config.load_document(tmp_path / "body.yaml", Body)
    with pytest.raises(ConfigError, match="cannot be read"):
        config.load_document(tmp_path, Body)
    (tmp_path / "body.yaml").write_bytes(b"name: \xff\xfe")
    with pytest.raises(ConfigError, match="is not a text file in UTF-8"):
        config.load_document(tmp_path / "body.yaml", Body)


@pytest.mark.parametrize("coding", ["utf-8-sig", "utf-16"])
def test_a_byte_order_mark_is_no_text(tmp_path: Path, coding: str) -> None:
    (tmp_path / "list.txt").write_text("grün\n", encoding=coding)
    assert config.read_text(tmp_path / "list.txt") == "grün\n"


def test_a_configuration_is_found_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = config.find_config("world_demo")
    assert found == config.find_config("world_demo.yaml") == config.find_config("configs/world_demo.yaml")
    assert found.name == "world_demo.yaml"
    with pytest.raises(
        ConfigError, match=r"no_such_world: there is no such file; fpplab brings .*world_demo"
    ):
        config.find_config("no_such_world")
    with pytest.raises(ConfigError, match="there is no such file"):
        config.find_config(tmp_path / "world_demo.yaml")


def test_numbers_are_read_as_an_operator_writes_them() -> None:
    assert config.parse_yaml("[1e-3, 2E+5, -1e3, 1.5e2, 7]", "x") == [1e-3, 2e5, -1e3, 150.0, 7]
    assert config.parse_yaml("[1e, e3, '1e3', v1e3]", "x") == ["1e", "e3", "1e3", "v1e3"]


def test_aliases_that_multiply_are_refused_at_once() -> None:
    """Ten levels of ten aliases each would be ten thousand million values."""
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{k}: &a{k} [{', '.join(10 * [f'*a{k - 1}'])}]\n" for k in range(1, 11)
    )
    with pytest.raises(ConfigError, match=r"line \d+: there are more than 100000 values, those that aliases"):
        config.parse_yaml(bomb, "x")
    assert config.parse_yaml("a: &one [1, 2]\nb: *one", "x") == {"a": [1, 2], "b": [1, 2]}


@pytest.mark.parametrize(
    "word", ["2026-11-23", "2026-11-23 10:00:00", "0x1F", "0o17", "017", "0b11", "12:30:00", "<<", "=", "1_"]
)
def test_what_yaml_takes_for_dates_and_odd_numbers_is_a_word(word: str) -> None:
    assert config.parse_yaml(f"[{word}]", "x") in ([word], [1])
    assert config.parse_yaml(f"{word}: 1", "x") in ({word: 1}, {1: 1})


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(min_size=1), inner, max_size=4),
    max_leaves=12,
)


@given(PLAIN)
def test_plain_data_survive_the_file(data: object) -> None:
    """Above all words that look like numbers: serial numbers such as 21e7."""
    assert config.parse_yaml(config.to_yaml(data), "x") == data


@pytest.mark.parametrize(
    "word",
    ["21e7", "1e5", "0x10", "1_000", "yes", "null", "2026-11-21", "12:30", "~", "=", "\x85", "a\u2028b"],
)
def test_words_that_look_like_something_else_stay_words(word: str) -> None:
    assert config.parse_yaml(config.to_yaml({"serial": word}), "x") == {"serial": word}


def test_every_kind_of_error_has_its_exit_code() -> None:
    codes: dict[type[errors.FppError], int] = {
        errors.ConfigError: 2,
        errors.DeviceError: 3,
        errors.SyncError: 3,
        errors.DataError: 4,
        errors.CalibrationError: 5,
        errors.Cancelled: 130,
    }
    assert {kind: kind.exit_code for kind in codes} == codes
    assert all(issubclass(kind, errors.FppError) for kind in codes)


def test_a_device_error_says_who_what_and_what_to_do() -> None:
    error = errors.LimitError("stage", "move_to", "70 mm was asked for", "the travel is 0 to 50 mm")
    assert str(error) == "stage: move_to: 70 mm was asked for; the travel is 0 to 50 mm"
    assert (error.device, error.operation) == ("stage", "move_to")


def test_what_was_meant_is_a_file_of_the_kind_or_of_none(tmp_path: Path) -> None:
    for name in ("rig_skull.yaml", "skulls.yaml"):
        (tmp_path / name).touch()
    with pytest.raises(errors.ConfigError, match=r"did you mean .*/skulls\.yaml\?"):
        config.find_config(tmp_path / "skull.yaml", "plan")
    (tmp_path / "plan_skull.yaml").touch()
    with pytest.raises(errors.ConfigError, match=r"did you mean .*/plan_skull\.yaml\?"):
        config.find_config(tmp_path / "plan_skul.yaml", "plan")
    (tmp_path / "plan_skull.yaml").unlink()
    with pytest.raises(errors.ConfigError) as refused:
        config.find_config(tmp_path / "ri_skull.yaml", "plan")
    assert "rig_skull" not in str(refused.value), "a rig file is no plan"
