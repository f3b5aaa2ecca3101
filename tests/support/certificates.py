"""Certificates of a laboratory, made as the page on several computers says."""

import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.commands import ROOT

PAGE = ROOT / "docs" / "how-to" / "several-computers.md"


def make_certificate(folder: Path) -> Path:
    """The folder of a new certificate, made by the page's own commands; its key is shorter."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    folder.mkdir()
    lines = PAGE.read_text(encoding="utf-8").split("```sh\n")[1].split("```")[0].splitlines()
    for line in lines:
        words = shlex.split(line.replace("rsa:3072", "rsa:2048"))
        subprocess.run(words, cwd=folder, check=True, capture_output=True)
    return folder / "lab"
