"""The site as a reader gets it: built without a warning, read without a network, wide and on a phone."""

import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import fpplab
from docs.generate.pages import DOCS, ROOT, PageError
from docs.generate.reference import FILES, api_page, commands_page, every_command, files_page
from docs.generate.running import GALLERY, run_once
from docs.generate.site import build_site, make_pictures
from tests.support.browser import Browser, chromium, number_of_colours, pixels_of

pytestmark = pytest.mark.timeout(1800)  # the pictures take minutes
SCREENS = ROOT / "build" / "docs" / "screens"
WIDTHS = {"wide": (1280, 900), "phone": (390, 844)}
SHOWN = {
    "index.html": "fpplab",
    "tutorial/first-scan.html": "Your first scan",
    "tour.html": "A tour: one measurement, with pictures",
    "gallery.html": "Gallery: good scans, difficult parts and typical faults",
    "how-to/your-part-in-the-twin.html": "Your own part in the simulation",
    "explanation/architecture.html": "Architecture in five minutes",
    "reference/commands.html": "Commands",
    "reference/files.html": "Files",
    "reference/api.html": "Python names",
    "decisions/index.html": "Decisions",
}
"""Pages of the site with their headings."""
REPORTS = {"pyramid/report.html": "unverified", "calibration.html": "good", "bright/report.html": "useless"}
"""Reports that the tutorial leaves, with their verdicts."""
PICTURES_SHOWN = "[...document.images].every(i => i.complete && i.naturalWidth > 0)"
TOO_WIDE = "document.documentElement.scrollWidth > window.innerWidth + 1"


@pytest.fixture(scope="module")
def site() -> Path:
    make_pictures()
    return build_site().parent


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    SCREENS.mkdir(parents=True, exist_ok=True)
    with chromium(tmp_path_factory.mktemp("chromium")) as running:
        yield running


@pytest.mark.nightly
def test_the_site_shows_its_pages(site: Path, browser: Browser) -> None:
    for width, (across, down) in WIDTHS.items():
        for path, heading in SHOWN.items():
            browser.open(site / path, across, down)
            where = f"{path}, {width}"
            assert browser.run("document.querySelector('h1').firstChild.textContent") == heading, where
            browser.run("document.querySelectorAll('img').forEach(i => i.loading = 'eager')")
            browser.until(PICTURES_SHOWN)
            assert not browser.run(TOO_WIDE), where
            assert browser.faults() == [], where
            assert [url for url in browser.requests() if not url.startswith("file:")] == [], where
            shot = browser.screenshot(SCREENS / f"{path.replace('/', '-')}.{width}.png")
            assert number_of_colours(pixels_of(shot)) > 40, where


@pytest.mark.nightly
def test_the_site_is_searched_from_the_disk(site: Path, browser: Browser) -> None:
    """By a word that only the glossary and the commands have: what others call a characterisation."""
    browser.open(site / "index.html", *WIDTHS["wide"])
    browser.until("!document.querySelector('.md-search').hidden")
    browser.run(
        "{const q = document.querySelector('input[name=query]'); document.querySelector('#__search').click();"
        "q.value = 'calibrate'; for (const kind of ['input', 'keyup']) q.dispatchEvent(new Event(kind))}"
    )
    browser.until("document.querySelectorAll('.md-search-result__item').length > 2")
    assert browser.faults() == []


@pytest.mark.nightly
def test_reports_of_the_tutorial_are_shown(browser: Browser) -> None:
    folder = run_once(DOCS / "tutorial" / "first-scan.md")
    for width, (across, down) in WIDTHS.items():
        for path, verdict in REPORTS.items():
            browser.open(folder / path, across, down)
            browser.until(PICTURES_SHOWN)
            assert verdict in browser.run("document.body.innerText").lower(), path
            assert not browser.run(TOO_WIDE), f"{path}, {width}"
            assert [u for u in browser.requests() if not u.startswith("file:")] == []
            browser.screenshot(SCREENS / f"{path.replace('/', '-')}.{width}.png")


@pytest.mark.nightly
def test_pages_link_to_what_there_is(site: Path) -> None:
    """Links and anchors in the built pages, those between generated pages too."""
    pages = {
        path: path.read_text(encoding="utf-8") for path in site.rglob("*.html") if path.name != "404.html"
    }
    anchors = {path: set(re.findall(r'\bid="([^"]+)"', text)) for path, text in pages.items()}
    missing = []
    for path, text in pages.items():
        # Scripts contain links, too.
        written = re.sub(r"(<script[^>]*>).*?</script>", r"\1", text, flags=re.DOTALL)
        for link in re.findall(r'<(?:a|img|link|script)[^>]*?\b(?:href|src)="([^"]+)"', written):
            if re.match(r"(https?|mailto|data|javascript):", link):
                continue
            file, _, anchor = link.partition("#")
            target = (path.parent / file).resolve() if file else path
            if not target.exists() or (anchor and target in anchors and anchor not in anchors[target]):
                missing.append(f"{path.relative_to(site)}: {link}")
    assert missing == []


def test_scripts_and_pages_are_run_and_their_faults_told(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[Path] = []
    monkeypatch.setattr("docs.generate.site.verdict_of", done.append)
    monkeypatch.setattr("docs.generate.site.run_once", done.append)
    make_pictures()
    assert sorted(done) == sorted([DOCS / "tour.md", *GALLERY])

    def failing(path: Path) -> None:
        raise PageError(f"{path.name} shows what does not happen")

    monkeypatch.setattr("docs.generate.site.run_once", failing)
    with pytest.raises(PageError, match=r"tour\.md shows"):
        make_pictures()
    monkeypatch.setattr("docs.generate.site.run_once", done.append)
    monkeypatch.setattr("docs.generate.site.verdict_of", failing)
    with pytest.raises(PageError, match=r"\.py shows"):
        make_pictures()


PHONE_COLUMN_PX = 358
"""Width of a picture in a window of 390 px."""
DRAWING = [DOCS / "tour.md", *(one for one in GALLERY if "figsize" in one.read_text(encoding="utf-8"))]
BENCH = ROOT / "examples" / "gallery" / "bench.py"


@pytest.mark.parametrize("source", [*DRAWING, BENCH], ids=lambda source: source.stem)
def test_text_in_pictures_is_legible_on_a_phone(source: Path) -> None:
    """At least 10 px high, as the page shows it."""
    text = source.read_text(encoding="utf-8")
    settings = text if source.suffix == ".md" else BENCH.read_text(encoding="utf-8")
    (points,) = re.findall(r'"font\.size": ([\d.]+)', settings)
    assert "fontsize" not in text
    for inches in re.findall(r"figsize=\(([\d.]+),", text):
        assert float(points) / 72 / float(inches) * PHONE_COLUMN_PX >= 10, f"{inches} inches"


def test_every_public_name_is_in_the_reference_and_has_a_docstring() -> None:
    page = api_page()
    for name in fpplab.__all__:
        if name != "__version__":
            thing = getattr(fpplab, name)
            assert f".{thing.__qualname__}\n" in page, name
            assert inspect.getdoc(thing), name


def test_every_command_and_option_is_in_the_reference_with_words() -> None:
    page = commands_page()
    for name, command in every_command():
        assert f"## fpplab {name}\n" in page
        assert command.help, name
        for parameter in command.params:
            assert getattr(parameter, "help", None) or parameter.hidden, f"fpplab {name}: {parameter.name}"


def test_every_key_of_a_file_is_in_the_reference_with_words() -> None:
    rows = [
        [*map(str.strip, row.strip("|").split(" | "))] for row in re.findall(r"^\| `.*", files_page(), re.M)
    ]
    for kind, (_, model) in FILES.items():
        for key in model.model_fields:
            assert [row for row in rows if row[0] == f"`{key}`"], f"{kind}: {key}"
    assert [row[0] for row in rows if len(row) != 4 or not row[3]] == []
