"""Loose images that are not what was promised."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as Pillow

from fpplab.core.conventions import Lattice
from fpplab.core.errors import ConfigError, DataError
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.sessions.image_selection import ImageSelection
from fpplab.sessions.importing import import_images
from fpplab.sessions.session import Session
from tests.support.recorded import PLAN, image_of

NAMES = "f_{index:02d}.png"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "images"
    folder.mkdir()
    for index in range(PLAN.images):
        Pillow.fromarray(image_of(index)).save(folder / NAMES.format(index=index))
    return folder


def bring(folder: Path, names: str = NAMES, first: int = 0, **options: Any) -> Session:
    return import_images(ImageSelection((folder,), names, first), PLAN, folder.parent / "session", **options)


def refuses(folder: Path, complaint: str, error: type[Exception] = DataError, **options: Any) -> None:
    with pytest.raises(error, match=complaint):
        bring(folder, **options)
    assert [p.name for p in folder.parent.iterdir()] == ["images"], "something half-made is left"


def replace(folder: Path, index: int, image: np.ndarray[Any, Any]) -> None:
    Pillow.fromarray(image).save(folder / NAMES.format(index=index))


def test_good_images_come_in_whole(folder: Path) -> None:
    shares: list[float] = []
    session = bring(folder, progress=shares.append)
    assert shares == [0.25, 0.5, 0.75, 1.0]
    assert session.projector()[0] == (64, 48)
    for index, image in enumerate(Session.open(session.path).stack()):
        np.testing.assert_array_equal(image, image_of(index))
    with pytest.raises(ConfigError, match="exists already"):
        bring(folder)
    assert bring(folder, force=True).missing() == []


def test_images_of_several_exposures_come_one_exposure_after_the_other(folder: Path) -> None:
    for index in range(PLAN.images, 2 * PLAN.images):
        replace(folder, index, image_of(index))
    plan = PLAN.model_copy(update={"exposures_s": (0.04, 0.01)})
    session = import_images(ImageSelection((folder,), NAMES), plan, folder.parent / "session")
    assert [record.settings.exposure_s for record in session.records] == [0.04] * 4 + [0.01] * 4
    assert session.missing() == []
    np.testing.assert_array_equal(session.passes()[1].frames[2], image_of(6))


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_deep_images_come_in_whole(folder: Path, bits: int) -> None:
    for index in range(4):
        replace(folder, index, image_of(index).astype(np.uint16) * 4)
    session = bring(folder, bits=bits)
    assert session.format == (20, 16, bits)
    np.testing.assert_array_equal(session.read(2), image_of(2).astype(np.uint16) * 4)


def test_missing_images(folder: Path) -> None:
    for index in (1, 3):
        (folder / NAMES.format(index=index)).unlink()
    refuses(folder, r"2 of the plan's 4 frames are missing \(f_01.png, f_03.png\); looked for 'f_")


def test_no_folder(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is not a folder"):
        bring(tmp_path / "nowhere")


def test_an_image_in_colour(folder: Path) -> None:
    replace(folder, 2, image_of(2)[..., None] // np.array([8, 1, 4], np.uint8))
    refuses(folder, r"f_02.png: is in colour: its channels differ by up to \d+ grey levels .* green channel")


def test_an_image_with_transparency(folder: Path) -> None:
    replace(folder, 2, np.dstack([image_of(2), np.full((16, 20), 200, np.uint8)]))
    refuses(folder, r"f_02.png: is transparent in part")


def test_an_image_of_another_size(folder: Path) -> None:
    replace(folder, 3, np.zeros((16, 21), np.uint8))
    refuses(folder, "f_03.png: is 21 x 16 pixels but the first image is 20 x 16")


def test_one_image_under_two_names(folder: Path) -> None:
    replace(folder, 3, image_of(1))
    refuses(folder, "f_03.png: is the same image as f_01.png; every step has an image of its own")


def test_more_bits_than_promised(folder: Path) -> None:
    replace(folder, 1, image_of(1).astype(np.uint16) * 257)
    refuses(folder, "f_01.png: holds 16-bit grey levels but the first image 8-bit ones")


def test_fewer_bits_than_promised(folder: Path) -> None:
    refuses(folder, "f_00.png: holds 8-bit grey levels but 12 bits were stated; see --bits", bits=12)


def test_a_level_that_the_bits_do_not_hold(folder: Path) -> None:
    for index in range(4):
        replace(folder, index, np.full((16, 20), 4096 if index == 2 else 4090 + index, np.uint16))
    refuses(folder, "f_02.png: has a grey level of 4096, more than 12 bits hold", bits=12)


def test_an_image_cut_off_anywhere(folder: Path) -> None:
    """Whatever is accepted of a truncated file has every pixel right."""
    path = folder / "f_01.png"
    data = path.read_bytes()
    accepted: list[int] = []
    complaints: set[str] = set()
    for length in range(0, len(data), 5):
        path.write_bytes(data[:length])
        try:
            session = bring(folder, force=True)
        except DataError as error:
            complaints.add(str(error).partition("(")[0])
        else:
            np.testing.assert_array_equal(session.read(1), image_of(1))
            accepted.append(len(data) - length)
    assert complaints == {
        f"{path}: is empty; save single images as PNG or TIFF ",
        f"{path}: is truncated or damaged ",
    }
    assert all(lost <= 20 for lost in accepted), "only checksums and the empty end chunk may lack"


def test_an_image_with_a_flipped_bit(folder: Path) -> None:
    path = folder / "f_01.png"
    data = path.read_bytes()
    middle = data.index(b"IDAT") + 20
    path.write_bytes(data[:middle] + bytes([data[middle] ^ 4]) + data[middle + 1 :])
    refuses(folder, "f_01.png: is truncated or damaged")


def test_no_image_at_all(folder: Path) -> None:
    (folder / "f_00.png").write_text("hello")
    refuses(folder, "f_00.png: is a text file; save single images as PNG or TIFF")


@pytest.mark.parametrize(
    "names",
    [
        "f.png",
        "f_{}.png",
        "f_{0}.png",
        "f_{i}.png",
        "f_{index",
        "f_{index:s}.png",
        "{index}{index}",
        "{index.real}",
    ],
)
def test_a_wrong_format(folder: Path, names: str) -> None:
    refuses(folder, r"--frames is '.*': expected one \{index\}", ConfigError, names=names)


def test_a_full_disk_leaves_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def full(handle: int) -> None:
        calls.append(handle)
        if len(calls) == 6:
            raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        refuses(folder, "no space left on the disk")
    assert bring(folder).missing() == []


def test_names_that_count_from_one(folder: Path) -> None:
    for index in reversed(range(4)):
        (folder / NAMES.format(index=index)).rename(folder / NAMES.format(index=index + 1))
    refuses(folder, r"1 of the plan's 4 frames are missing \(f_00.png\).* from index 0; .* --first 1$")
    session = bring(folder, first=1)
    np.testing.assert_array_equal(session.read(3), image_of(3))


def test_more_images_than_the_plan_has(folder: Path) -> None:
    for index in (4, 11):
        Pillow.fromarray(image_of(index)).save(folder / NAMES.format(index=index))
    Pillow.fromarray(image_of(9)).save(folder / "dark.png")
    refuses(folder, r"has 2 images more than the plan's 4 \(f_04.png, f_11.png\): the plan lacks")


def test_left_justified_levels_are_moved(folder: Path) -> None:
    for index in range(4):
        replace(folder, index, image_of(index).astype(np.uint16) * 16 * 15)
    said: list[str] = []
    session = bring(folder, bits=12, warn=said.append)
    np.testing.assert_array_equal(session.read(2), image_of(2).astype(np.uint16) * 15)
    assert session.format == (20, 16, 12)
    assert len(said) == 1
    assert "moved to the lower ones" in said[0]
    said.clear()
    bring(folder, bits=16, force=True, warn=said.append)
    assert len(said) == 1
    assert "with --bits 12 saturated pixels" in said[0]


def test_one_odd_level_is_not_left_justified(folder: Path) -> None:
    for index in range(4):
        replace(folder, index, image_of(index).astype(np.uint16) * 16 * 15 + (index == 3))
    refuses(folder, r"has a grey level of \d+, more than 12 bits hold", bits=12)


def test_right_justified_levels_say_nothing(folder: Path) -> None:
    said: list[str] = []
    bring(folder, warn=said.append)
    for index in range(4):
        replace(folder, index, image_of(index).astype(np.uint16) * 4 + 1)
    bring(folder, bits=12, force=True, warn=said.append)
    assert not said


def test_jpeg_is_warned_of(folder: Path) -> None:
    for index in range(4):
        Pillow.fromarray(image_of(index)).save(folder / f"f_{index:02d}.jpg")
    said: list[str] = []
    bring(folder, "f_{index:02d}.jpg", warn=said.append)
    assert len(said) == 1
    assert "4 images are compressed with loss, as JPEG files are (f_00.jpg, " in said[0]


def test_the_projector_is_asked_for(folder: Path) -> None:
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=1, steps=4),))
    out = folder.parent / "session"
    with pytest.raises(ConfigError, match=r"^--projector-size is missing, and the plan's fringes have no"):
        import_images(ImageSelection((folder,), NAMES), plan, out)
    assert not out.exists()
    with pytest.raises(
        ConfigError, match="--lattice is missing: 912 x 1140 are the mirrors of a LightCrafter 4500"
    ):
        import_images(ImageSelection((folder,), NAMES), plan, out, projector_size=(912, 1140))
    assert not out.exists()
    import_images(
        ImageSelection((folder,), NAMES), plan, out, projector_size=(912, 1140), lattice=Lattice.DIAMOND
    )
    session = Session.open(out)
    assert session.projector() == ((912, 1140), Lattice.DIAMOND)
    assert session.recording().plan == plan


def test_a_projector_that_is_not_the_plans(folder: Path) -> None:
    refuses(folder, r"'projector_size' is \[64, 48\] but the projector has \[48, 64\]", ConfigError,
            projector_size=(48, 64))  # fmt: skip
    assert bring(folder, lattice=Lattice.DIAMOND).projector() == ((64, 48), Lattice.DIAMOND)


KILLED = """
import os, signal
from pathlib import Path
from tests.sessions.test_importing import bring

def kill(share: float) -> None:
    if share >= SHARE:
        os.kill(os.getpid(), signal.SIGKILL)

bring(Path(FOLDER), force=True, progress=kill)
"""


@pytest.mark.whole
@pytest.mark.parametrize("share", [0.25, 1.0])
def test_a_killed_import_leaves_nothing_under_its_name(folder: Path, share: float) -> None:
    script = KILLED.replace("FOLDER", repr(str(folder))).replace("SHARE", str(share))
    killed = subprocess.run([sys.executable, "-c", script], cwd=Path(__file__).parents[2], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert not (folder.parent / "session").exists()
    assert bring(folder).missing() == []
    assert sorted(path.name for path in folder.parent.iterdir()) == ["images", "session"]


def test_an_import_that_is_interrupted_leaves_what_it_would_replace(folder: Path) -> None:
    before = bring(folder).records

    def interrupt(share: float) -> None:
        if share >= 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bring(folder, force=True, progress=interrupt)
    assert Session.open(folder.parent / "session").records == before
    assert sorted(path.name for path in folder.parent.iterdir()) == ["images", "session"]


def test_a_bayer_filter_is_recorded_with_the_projector(folder: Path) -> None:
    session = bring(folder, bayer="GBRG")
    assert (session.bayer, session.projector()) == ("GBRG", ((64, 48), Lattice.SQUARE))
    assert session.recording().bayer == "GBRG"
    assert bring(folder, force=True).bayer is None


def test_an_unknown_filter_is_refused(folder: Path) -> None:
    complaint = "--bayer is 'rggb': must be one of RGGB, GRBG, GBRG, BGGR"
    refuses(folder, complaint, ConfigError, bayer="rggb")
