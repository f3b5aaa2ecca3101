"""Nested results as lines and tables."""

from fpplab.cli.console import as_table, readable


def test_values_in_one_line() -> None:
    assert readable(0.123456) == "0.1235"
    assert readable({"a": 1, "b": [2.0, "c"]}) == "a 1, b 2, c"
    assert [readable(one) for one in (None, [], {}, (), "")] == ["none"] * 4 + [""]


def test_dictionaries_in_a_list_are_rows() -> None:
    found = as_table([{"model": "k1", "fitted": {"camera": 1, "projector": 2}}, {"model": "k2", "note": "x"}])
    assert found == (
        ["model", "fitted camera", "fitted projector", "note"],
        [["k1", 1, 2, ""], ["k2", "", "", "x"]],
    )


def test_dictionaries_by_name_are_rows_with_names() -> None:
    assert as_table({"fx": {"unit": "px", "stated": 0.3}}) == (["", "unit", "stated"], [["fx", "px", 0.3]])


def test_all_else_is_no_table() -> None:
    for value in ([], {}, 1, "x", {"a": 1}, [1, 2], {"a": {"b": 1}, "c": 2}, [{"a": 1}, 2]):
        assert as_table(value) is None
