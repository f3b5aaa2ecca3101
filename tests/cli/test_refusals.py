"""Every kind of file into every argument: what is said is what was reviewed."""

from pathlib import Path

import pytest

from fpplab.core.file_kinds import describe_file
from tests.cli.refusals import ARGUMENTS, cells, reviewed
from tests.support.file_kinds import CONFIGS, make_files

SAMPLE = ("calibration.yaml", "cut_cloud.ply", "my_images", "opencv.yml", "page.yaml", "plan.yaml")
SAMPLED_ARGUMENTS = [line for line in ARGUMENTS if line.split()[0] in ("decode", "target", "convert")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("kinds")
    make_files(path)
    return path


@pytest.fixture
def names(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.chdir(folder)
    return sorted(path.name for path in folder.iterdir() if path.name not in ("world_demo.yaml", "o"))


def test_a_sample_of_the_table(names: list[str]) -> None:
    expected = reviewed()
    for line, said in cells(SAMPLE, SAMPLED_ARGUMENTS).items():
        assert said == {name: expected[line][name] for name in said}, line


@pytest.mark.whole
def test_a_quarter_of_the_table(names: list[str]) -> None:
    expected = reviewed()
    for part in range(2):
        for line, said in cells(names[part::4], list(ARGUMENTS)[part::2]).items():
            assert said == {name: expected[line][name] for name in said}, line


@pytest.mark.nightly
def test_the_table(names: list[str]) -> None:
    assert cells(names) == reviewed()


def test_what_is_said_of_a_wrong_file_is_a_refusal() -> None:
    kinds = reviewed().pop("kinds")
    for line, said in reviewed().items():
        for name, answer in said.items():
            code, _, sentence = answer.partition(" ")
            assert code in "0245" if line != "kinds" else answer == kinds[name], (line, name)
            if code in "245" and sentence:
                assert "Error:" not in sentence, (line, name)


def test_own_files_are_recognised_as_what_their_readers_take(names: list[str]) -> None:
    kinds = {name: describe_file(Path(f"{name}.yaml")) for name in CONFIGS}
    assert kinds == {name: reviewed()["kinds"][f"{name}.yaml"] for name in CONFIGS}
    assert len(set(kinds.values())) == len(CONFIGS)
