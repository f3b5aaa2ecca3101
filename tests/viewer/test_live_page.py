"""The set-up as an operator has it: buttons and images of its page in a real browser."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.setup.live.benches import rig_file
from tests.setup.live.test_expectation import converging
from tests.support.browser import SOFTWARE_WEBGL, Browser, chromium, hosts, number_of_colours
from tests.support.commands import ROOT

FILLED = 4000
"""Least number of colours of the page; without images it has less than a third."""


def address_of(program: subprocess.Popen[str]) -> str:
    assert program.stderr is not None
    for line in program.stderr:
        if line.startswith("Buttons and images: "):
            return line.split(": ", 1)[1].strip()
    raise AssertionError("no page was announced")


def press(browser: Browser, order: str) -> None:
    """Click on a button, where it is on the screen."""
    box = f"document.querySelector('[data-order={order}]').getBoundingClientRect()"
    browser.run(f"document.querySelector('[data-order={order}]').scrollIntoView()")
    x, y = browser.run(f"(b => [b.left + b.width / 2, b.top + b.height / 2])({box})")
    browser.drag((x, y), (x, y))


@pytest.mark.whole
def test_the_set_up_is_operated_in_a_browser(tmp_path: Path) -> None:
    converging(18.0).save(tmp_path / "calibration.yaml")
    words = ["live", "--rig", str(rig_file(tmp_path)), "--calibration", str(tmp_path / "calibration.yaml")]
    out = tmp_path / "live.rrd"
    command = [sys.executable, "-m", "fpplab", *words, "--out", str(out), "--seconds", "240", "--json"]
    environment = {**os.environ, "DISPLAY": "", "WAYLAND_DISPLAY": ""}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=environment
    ) as program:
        try:
            with chromium(tmp_path, *SOFTWARE_WEBGL) as browser:
                browser.open(address_of(program), 1600, 1000)
                seen = browser.coloured_picture(tmp_path / "live.png", FILLED)
                assert number_of_colours(seen) >= FILLED
                pressed = "document.querySelector('[data-order={}]').getAttribute('aria-pressed') === 'true'"
                browser.until(pressed.format("measure"))
                press(browser, "white")
                browser.until(pressed.format("white"))
                before = browser.run("document.querySelector('#exposure').textContent")
                press(browser, "longer")
                browser.until(f"document.querySelector('#exposure').textContent !== {json.dumps(before)}")
                press(browser, "measure")
                browser.until(pressed.format("measure"))
                browser.coloured_picture(tmp_path / "measured.png", FILLED)
                press(browser, "quit")
                answer, _ = program.communicate(timeout=60)
            assert program.returncode == 0
        finally:
            program.kill()
    assert json.loads(answer)["exposure_s"] == pytest.approx(0.02 * 2**0.5, rel=0.01)
    assert hosts(browser.log) == {"127.0.0.1"}
    assert out.stat().st_size > 10_000
