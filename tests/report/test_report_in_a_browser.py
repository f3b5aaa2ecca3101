"""Pages opened in a browser: nothing is fetched, the cloud is drawn and turned, phones, dark mode, print."""

import base64
import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image as Pixels

from fpplab.core.notebook import grey_picture, html_table
from fpplab.diagnosis import Diagnosis, Finding, Verdict
from fpplab.diagnosis.causes.ambient import AMBIENT
from fpplab.report.measurements import write_report
from fpplab.report.page import PageBasis
from fpplab.results.provenance import Provenance
from tests.report.test_report import Page, scan
from tests.support.browser import NO_WEBGL, SOFTWARE_WEBGL, Browser, chromium

HOSTILE = "</script><script>document.title='run'</script><img src=x onerror=document.title='run'>&\"'"
STAGE = "document.querySelector('figure.live canvas')"


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A page of one scan with a true shape and hostile words in every place, and one of two scans."""
    folder = tmp_path_factory.mktemp("pages")
    finding = Finding(AMBIENT, HOSTILE, 2.0, HOSTILE)
    doubtful = Diagnosis(Verdict.DOUBTFUL, HOSTILE, (finding,), (HOSTILE,))
    source = Provenance({"rig": HOSTILE, "camera": None, "session": "/a/very/long/path" * 20})
    one = replace(scan(HOSTILE), diagnosis=doubtful, provenance=source)
    write_report(
        folder / "one.html", HOSTILE, scans=[one], verdicts_and_sources=PageBasis(answer={"verdict": HOSTILE})
    )
    good = replace(
        scan("steps", truth=False),
        decoded=None,
        diagnosis=Diagnosis(Verdict.GOOD, "100800 points of 101104", ()),
        provenance=source,
    )
    write_report(folder / "two.html", "Two", scans=[replace(good, name="pillars"), good])
    return {"one": folder / "one.html", "two": folder / "two.html"}


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with chromium(tmp_path_factory.mktemp("chromium"), *SOFTWARE_WEBGL) as running:
        yield running


def canvas(browser: Browser) -> NDArray[np.uint8]:
    """What the first view shows, RGB."""
    link = browser.run(f"{STAGE}.toDataURL('image/png')")
    return np.asarray(Pixels.open(io.BytesIO(base64.b64decode(link.split(",")[1]))).convert("RGB"))


def painted(picture: NDArray[np.uint8]) -> float:
    """Share of the pixels that are not the ground."""
    return float((np.abs(picture.astype(int) - picture[0, 0]).max(axis=2) > 8).mean())


def wait_for_view(browser: Browser) -> None:
    browser.run("document.querySelector('figure.view').scrollIntoView({block: 'center'})")
    browser.until("document.querySelector('figure.live') !== null")


@pytest.mark.parametrize("name", ["one", "two"])
def test_a_page_opens_alone_and_without_a_fault(
    browser: Browser, pages: dict[str, Path], name: str, tmp_path: Path
) -> None:
    browser.open(pages[name])
    wait_for_view(browser)
    picture = Pixels.open(io.BytesIO(browser.screenshot(tmp_path / f"{name}.png", whole=True)))
    assert len(picture.convert("RGB").getcolors(1 << 24)) > 200  # type: ignore[arg-type]
    assert browser.faults() == []
    assert browser.requests() == [pages[name].resolve().as_uri()]
    assert browser.run("document.title") in (HOSTILE, "Two")
    milliseconds = browser.run("performance.timing.loadEventEnd - performance.timing.navigationStart")
    assert 0 < milliseconds < 10_000  # a second on a computer that has nothing else to do
    assert pages[name].stat().st_size < 6e6


def test_hostile_words_stay_words(browser: Browser, pages: dict[str, Path]) -> None:
    browser.open(pages["one"])
    wait_for_view(browser)
    assert browser.run("document.title") == HOSTILE
    assert browser.run("document.querySelector('.reason').textContent") == HOSTILE
    assert browser.run("document.querySelectorAll('script').length") == 3  # cloud, its points, the program
    assert browser.run("document.querySelectorAll('[onerror]').length") == 0


def test_the_verdict_comes_first(browser: Browser, pages: dict[str, Path]) -> None:
    browser.open(pages["one"])
    top = "document.querySelector('.verdict').getBoundingClientRect()"
    assert browser.run(f"{top}.top") < 200
    assert browser.run("document.querySelector('.verdict .label').textContent.includes('Doubtful')")
    assert browser.run(
        "document.querySelector('.verdict').compareDocumentPosition(document.querySelector('figure')) === 4"
    )
    assert "not recorded" in Page(pages["one"]).cells


def test_the_cloud_is_drawn_turned_and_coloured(
    browser: Browser, pages: dict[str, Path], tmp_path: Path
) -> None:
    browser.open(pages["one"])
    wait_for_view(browser)
    first = canvas(browser)
    browser.screenshot(tmp_path / "first.png")
    assert 0.05 < painted(first) < 0.95
    choose = "s.selectedIndex = 1; s.dispatchEvent(new Event('change'))"
    browser.run(f"(s => {{ {choose} }})(document.querySelector('select'))")
    height = canvas(browser)
    assert np.mean(np.any(height != first, axis=2)) > 0.02
    assert painted(height) == pytest.approx(painted(first), rel=0.2)  # the same points, if not the white ones
    assert "in mm" in browser.run("document.querySelector('.bar .what').textContent")
    ticks = browser.run("[...document.querySelectorAll('.bar .ticks span')].map(s => +s.textContent)")
    assert len(ticks) >= 2
    assert all(400.0 <= tick <= 400.64 for tick in ticks)  # the range of z of the points
    box = browser.run(f"(b => [b.left + b.width / 2, b.top + b.height / 2])({STAGE}.getBoundingClientRect())")
    browser.drag((box[0], box[1]), (box[0] + 90, box[1] + 40))
    turned = canvas(browser)
    assert np.mean(np.any(turned != height, axis=2)) > 0.02
    zoomed = "dispatchEvent(new WheelEvent('wheel', {deltaY: -400, cancelable: true}))"
    browser.run(f"{STAGE}.focus(); {STAGE}.{zoomed}")
    assert painted(canvas(browser)) > 1.2 * painted(turned)
    browser.run("[...document.querySelectorAll('button')].find(b => b.textContent === 'Reset view').click()")
    assert np.array_equal(canvas(browser), height)


@pytest.mark.parametrize("width", [1400, 390])
def test_the_first_view_is_framed_on_the_points(
    browser: Browser, pages: dict[str, Path], tmp_path: Path, width: int
) -> None:
    """They fill nine tenths of the canvas in one direction, in its middle."""
    browser.open(pages["two"], width, 844)
    wait_for_view(browser)
    browser.screenshot(tmp_path / "framed.png")
    shown = canvas(browser)
    seen = np.abs(shown.astype(int) - shown[0, 0]).max(axis=2) > 8
    filled = []
    for axis in (0, 1):
        places = np.flatnonzero(seen.any(axis=1 - axis)) / (seen.shape[axis] - 1)
        assert places[0] + places[-1] == pytest.approx(1, abs=0.06)
        filled.append(places[-1] - places[0])
    assert 0.85 < max(filled) < 1


@pytest.mark.parametrize("width", [1400, 390])
def test_pictures_in_a_notebook_keep_their_shape(browser: Browser, tmp_path: Path, width: int) -> None:
    """Beside a table that is higher, and narrower than both."""
    rows = {f"a name of some length {row}": "a value of some length" for row in range(12)}
    page = "<meta charset='utf-8'><body>" + html_table("Cloud", rows, grey_picture(np.eye(100, 150)))
    (tmp_path / "notebook.html").write_text(page, encoding="utf-8")
    browser.open(tmp_path / "notebook.html", width, 844)
    size = browser.run("(i => [i.width, i.height, i.naturalWidth, i.naturalHeight])(document.images[0])")
    assert size == [150, 100, 150, 100]
    assert not browser.run("document.documentElement.scrollWidth > window.innerWidth")


def test_counts_of_a_verdict_have_separators(pages: dict[str, Path]) -> None:
    assert "100\u202f800 points of 101\u202f104" in pages["two"].read_text(encoding="utf-8")


def test_a_phone_scrolls_down_only(browser: Browser, pages: dict[str, Path], tmp_path: Path) -> None:
    for name, page in pages.items():
        browser.open(page, 360, 740)
        wait_for_view(browser)
        browser.screenshot(tmp_path / f"{name}_phone.png", whole=True)
        assert browser.run("document.documentElement.scrollWidth") == 360
        assert browser.run(f"{STAGE}.getBoundingClientRect().right") <= 360


def test_dark_mode_has_dark_colours(browser: Browser, pages: dict[str, Path], tmp_path: Path) -> None:
    brightness = {}
    for dark in (False, True):
        browser.open(pages["two"], dark=dark)
        wait_for_view(browser)
        seen = Pixels.open(io.BytesIO(browser.screenshot(tmp_path / f"dark_{dark}.png"))).convert("L")
        brightness[dark] = float(np.median(np.asarray(seen))), float(canvas(browser)[0, 0].mean())
    assert all(value > 225 for value in brightness[False])
    assert all(value < 60 for value in brightness[True])


def test_print_shows_the_still_picture(browser: Browser, pages: dict[str, Path], tmp_path: Path) -> None:
    browser.open(pages["one"])
    wait_for_view(browser)
    printed = base64.b64decode(browser.call("Page.printToPDF", printBackground=False)["data"])
    (tmp_path / "printed.pdf").write_bytes(printed)
    assert printed.startswith(b"%PDF")
    assert len(printed) > 20_000
    browser.call("Emulation.setEmulatedMedia", media="print")
    shown = "getComputedStyle(document.querySelector('{}')).display"
    assert browser.run(shown.format("figure.live .still")) == "block"
    assert browser.run(shown.format("figure.live .stage")) == "none"
    browser.call("Emulation.setEmulatedMedia", media="")


@pytest.mark.whole
def test_without_webgl_the_still_picture_stays(pages: dict[str, Path], tmp_path: Path) -> None:
    with chromium(tmp_path, *NO_WEBGL) as plain:
        plain.open(pages["one"])
        plain.run("document.querySelector('figure.view').scrollIntoView()")
        still = "document.querySelector('figure.view .still')"
        assert plain.run(f"{still}.complete && {still}.naturalWidth > 600 && {still}.offsetWidth > 300")
        assert plain.run("document.querySelector('canvas')") is None
        assert not [fault for fault in plain.faults() if "Uncaught" in fault]


def test_the_page_holds_its_figures_as_files(browser: Browser, pages: dict[str, Path]) -> None:
    browser.open(pages["one"])
    links = browser.run("[...document.querySelectorAll('a.save')].map(a => [a.download, a.href])")
    files = {name: base64.b64decode(link.partition(",")[2]).decode("utf-8") for name, link in links}
    held = json.loads(files.pop("report.json"))
    assert held["verdict"] == HOSTILE
    assert held["provenance"][HOSTILE]["camera"] is None
    assert "Surface RMS in µm" in files["table_1.csv"].splitlines()[0]
    assert "2432" in files["table_1.csv"]  # without a separator of thousands
    assert len(held["tables"]) >= 1
