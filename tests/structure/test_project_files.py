"""The files of the project that repeat what stands elsewhere agree with it."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

import pytest
import yaml
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parents[2]
DECISIONS = sorted((ROOT / "docs" / "decisions").glob("*.md"))
ARCHIVE = ROOT / "docs" / "decisions" / "archive"
MAX_WORDS = 250  # of a decision record: what holds today, and why


FOLDERS_AT_THE_ROOT = (
    *(".ci", ".github", "benchmarks", "configs", "docs", "drivers", "examples", "fpplab", "sim", "tests"),
)
FILES_AT_THE_ROOT = (
    *(".gitignore", ".pre-commit-config.yaml", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE"),
    *("Makefile", "README.md", "constraints-3.11.txt", "constraints-3.13.txt", "hatch_build.py"),
    *("mkdocs.yml", "pyproject.toml"),
)


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_nothing_else_is_at_the_root() -> None:
    """What a run or a person leaves there is not part of the project."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode or not (ROOT / ".git").exists():
        pytest.skip("this is not a checkout of git")
    assert {line.partition("/")[0] for line in listed.stdout.splitlines()} == {
        *FOLDERS_AT_THE_ROOT,
        *FILES_AT_THE_ROOT,
    }


def test_the_citation_is_of_this_version_and_licence() -> None:
    project, citation = tomllib.loads(text("pyproject.toml"))["project"], yaml.safe_load(text("CITATION.cff"))
    assert citation["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= set(citation)
    assert citation["version"] == project["version"]
    assert citation["license"] == project["license"]
    assert [author["name"] for author in citation["authors"]] == [a["name"] for a in project["authors"]]


def test_the_changelog_has_this_version() -> None:
    version = tomllib.loads(text("pyproject.toml"))["project"]["version"]
    headings = re.findall(r"^## \[(.+?)\](?: - (\d{4}-\d\d-\d\d))?$", text("CHANGELOG.md"), re.MULTILINE)
    assert headings[0] == ("Unreleased", "")
    assert version in [heading for heading, date in headings if date]


def test_versions_that_were_tested_run_with_the_first_release_of_their_python() -> None:
    """Debian 12 has Python 3.11.2: what needs a later one cannot be installed there."""
    minor = f"{sys.version_info.major}.{sys.version_info.minor}"
    too_new = {}
    for name in re.findall(r"^([\w.-]+)==", text(f"constraints-{minor}.txt"), re.MULTILINE):
        try:
            needed = metadata(name).get("Requires-Python") or ""
        except PackageNotFoundError:
            continue  # of an extra that is not installed here, or of another system
        if f"{minor}.0" not in SpecifierSet(needed):
            too_new[name] = needed
    assert too_new == {}


def test_hooks_are_local() -> None:
    hooks = yaml.safe_load(text(".pre-commit-config.yaml"))["repos"]
    assert [repository["repo"] for repository in hooks] == ["local"]
    assert all(hook["language"] == "system" for repository in hooks for hook in repository["hooks"])


def test_hosted_tests_install_what_the_documentation_names() -> None:
    (named,) = re.findall(
        r"`sudo apt-get install ([^`]+)`,\s+and a real projector or stage `(\S+)`",
        text("docs/how-to/install.md"),
    )
    wanted = {*named[0].split(), named[1]}
    for name in ("ci", "nightly"):
        assert wanted <= set(text(f".github/workflows/{name}.yml").split())


def test_hosted_tests_are_all_parts_of_the_local_ones() -> None:
    (job,) = yaml.safe_load(text(".github/workflows/ci.yml"))["jobs"].values()
    assert job["steps"][-1]["run"] == ".ci/run ${{ matrix.part }}"
    (parts,) = re.findall(r'^parts=" \$\{\*:-([a-z ]+)\} "$', text(".ci/run"), re.MULTILINE)
    assert job["strategy"]["matrix"]["part"] == parts.split()


def test_every_long_run_is_part_of_the_hosted_night() -> None:
    (job,) = yaml.safe_load(text(".github/workflows/nightly.yml"))["jobs"].values()
    (targets,) = re.findall(r"^nightly: (test-nightly .+)$", text("Makefile"), re.MULTILINE)
    assert [part.split()[0] for part in job["strategy"]["matrix"]["part"]] == targets.split()


def test_the_readme_is_short_and_shows_a_scan_and_its_errors() -> None:
    readme = text("README.md")
    assert len(readme.splitlines()) <= 95
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", readme)
    assert pictures == ["docs/pictures/scan.webp", "docs/pictures/freeform.jpg"]
    assert [name for name in pictures if not 10_000 < (ROOT / name).stat().st_size < 300_000] == []


def test_links_of_the_readme_lead_to_files() -> None:
    links = re.findall(r"\]\(([^)#]+)", text("README.md"))
    inside = [link for link in links if not link.startswith("https://")]
    assert [link for link in inside if not (ROOT / link).exists()] == []


@pytest.mark.parametrize(
    "package", tomllib.loads(text("pyproject.toml"))["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
)
def test_packages_announce_their_types(package: str) -> None:
    assert (ROOT / package / "py.typed").is_file()


def test_decision_records_are_short_dated_and_name_what_they_replace() -> None:
    archived = set()
    for path in DECISIONS:
        record = path.read_text(encoding="utf-8")
        heading = re.match(r"# .+\n\nDate: \d{4}-\d\d-\d\d(?: \(archive: ([\d, ]+)\))?\n\n", record)
        assert heading, path.name
        assert len(record.split()) <= MAX_WORDS, path.name
        archived |= {int(number) for number in (heading[1] or "").split(", ") if number}
    assert archived == {int(path.name[:4]) for path in ARCHIVE.glob("*.md")}


def test_the_glossary_is_sorted_and_names_files_that_exist() -> None:
    glossary = text("docs/glossary.md")
    terms = [term.lower() for term in re.findall(r"^\*\*(.+?)\*\*", glossary, re.MULTILINE)]
    assert terms == sorted(set(terms))
    named = re.findall(r"`((?:fpplab|sim|drivers|docs|tests|configs)/[\w/.\-]*)`", glossary)
    assert [name for name in named if not (ROOT / name).exists()] == []
