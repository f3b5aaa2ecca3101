"""Patterns in a firmware file, decoded pixel for pixel by a reader that shares no code with the builder."""

import hashlib
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from drivers.dlp4500.flash.compression import Compression, compress, encode_run_lengths
from drivers.dlp4500.flash.firmware import TABLE, Firmware, arrange_patterns
from drivers.dlp4500.index import FlashIndex
from drivers.dlp4500.sequence import SIZE, Slot
from drivers.emulators.dlpc350.flash import decompress_pixels, stored_images
from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.core.errors import ConfigError, DataError
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import Pattern, make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from tests.drivers.flash_files import BEHIND_PROGRAM, END, IMAGES, PROGRAM, maker_firmware
from tests.support.commands import run

WIDTH, HEIGHT = SIZE
GREY = uniform_patterns([7], SIZE)[0]
SPLASH_ENTRY = slice(TABLE + 176, TABLE + 180)


@pytest.fixture(scope="module")
def maker(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The maker's file."""
    file = tmp_path_factory.mktemp("firmware") / "maker.bin"
    file.write_bytes(maker_firmware())
    return file


def _built(maker: Path, patterns: list[Pattern]) -> bytes:
    return Firmware.load(maker).with_patterns(patterns, Path("built.bin")).content


def _noise(count: int) -> list[Pattern]:
    random = np.random.default_rng(2)
    return [
        Pattern(f"noise-{i}", random.integers(0, 256, (HEIGHT, WIDTH), np.uint8), 8) for i in range(count)
    ]


# --- compression ----------------------------------------------------------------------------------

GREYS = st.sampled_from([0, 1, 255])
"""Few grey levels, so that pixels repeat."""


@st.composite
def structured(draw: st.DrawFn) -> np.ndarray:
    """Rows with runs of lengths around the limit of a count byte."""
    lengths = draw(st.lists(st.sampled_from([1, 1, 1, 2, 3, 254, 255, 256, 257]), min_size=1, max_size=6))
    width, height = sum(lengths), draw(st.integers(1, 5))
    rows = []
    for _ in range(height):
        turned = draw(st.permutations(lengths))
        pixels = draw(hnp.arrays(np.uint8, (len(turned), 3), elements=GREYS))
        rows.append(np.repeat(pixels, turned, axis=0))
    return np.stack(rows).reshape(height, width, 3)


@given(st.one_of(structured(), hnp.arrays(np.uint8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12).map(
    lambda shape: (*shape, 3)), elements=GREYS)))  # fmt: skip
def test_runs_give_the_image_back(image):
    height, width, _ = image.shape
    assert np.array_equal(decompress_pixels(1, encode_run_lengths(image), width, height), image)


@given(st.integers(0, 2**32), st.integers(1, 600), st.integers(1, 3))
def test_literals_of_any_length_give_the_image_back(seed, width, height):
    image = np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)
    assert np.array_equal(decompress_pixels(1, encode_run_lengths(image), width, height), image)


@given(hnp.arrays(np.uint8, (9, 3, 3), elements=GREYS), st.booleans())
def test_what_is_chosen_gives_the_image_back(image, repeats):
    if repeats:
        image = image[np.arange(9) % 4]
    stored = compress(image)
    assert np.array_equal(decompress_pixels(stored.method, stored.data, 3, 9), image)
    assert (stored.method is Compression.FOUR_LINE) == np.array_equal(image[4:], image[:-4])


A, B, C = b"abc", b"xyz", b"123"
ROW = b"\0\0" + b"\0\0"
"""The end of a row, and zeros to a multiple of four here."""
END_OF_ALL = ROW + b"\0\1"


@pytest.mark.whole_after(2)
@pytest.mark.parametrize(
    ("rows", "stored"),
    [
        ([[A, A, A]], b"\x03abc" + END_OF_ALL),
        ([[A]], b"\x01abc" + END_OF_ALL),
        ([[A, B]], b"\0\x02abcxyz" + END_OF_ALL),
        ([[A, B, B], [C, C, C]], b"\x01abc\x02xyz" + ROW + b"\x03123" + END_OF_ALL),
        ([[A] * 256], b"\xffabc\x01abc" + END_OF_ALL),
    ],
    ids=["run", "one pixel", "literal", "rows", "more than a count"],
)  # fmt: skip
def test_the_bytes_of_runs(rows, stored):
    image = np.frombuffer(b"".join(map(b"".join, rows)), np.uint8).reshape(len(rows), -1, 3)
    assert encode_run_lengths(image) == stored.ljust(-(-len(stored) // 16) * 16, b"\0")


def test_the_shortest_way_is_chosen():
    noise = np.random.default_rng(3).integers(0, 256, (8, 40, 3), np.uint8)
    assert compress(noise).method is Compression.NONE
    assert compress(np.repeat(noise[:, :1], 40, axis=1)).method is Compression.RUN_LENGTH
    assert compress(noise[np.arange(8) % 4]).method is Compression.FOUR_LINE


# --- firmware -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["plan_paper.yaml", "plan_board.yaml"])
def test_a_plan_is_decoded_pixel_for_pixel(maker, name):
    patterns = make_patterns(Plan.load(name), SIZE, Lattice.DIAMOND)
    images = stored_images(_built(maker, patterns))
    slots = arrange_patterns(patterns)
    for slot, wanted in zip(slots, patterns, strict=True):
        assert np.array_equal(images[slot.image].planes[..., slot.number], wanted.image)
    empty = {(i, number) for i in range(len(images)) for number in range(3)}
    empty -= {(slot.image, slot.number) for slot in slots}
    assert not any(images[i].planes[..., number].any() for i, number in empty)


def test_four_bits_are_stored_in_half_the_planes(maker):
    sets = tuple(Sinusoid(axis="x", stripes=s, steps=3, pattern_bits=4) for s in (1, 8, 64))
    patterns = make_patterns(Plan(fringes=sets), SIZE, Lattice.DIAMOND)
    images, slots = stored_images(_built(maker, patterns)), arrange_patterns(patterns)
    assert ([slot.image for slot in slots], {slot.bits for slot in slots}) == ([0] * 6 + [1] * 3, {4})
    for slot, wanted in zip(slots, patterns, strict=True):
        colour, half = divmod(slot.number, 2)
        stored = images[slot.image].planes[..., colour] >> (4 * half) & 15
        assert np.array_equal(17 * stored, wanted.image)


def test_patterns_go_in_their_order_and_kinds_do_not_share_an_image():
    noise, grey = _noise(1)[0], GREY
    slots = arrange_patterns([grey, grey, grey, grey, noise, noise, grey])
    assert [(slot.image, slot.number) for slot in slots] == [
        (0, 0),
        (0, 1),
        (0, 2),
        (1, 0),
        (2, 0),
        (2, 1),
        (3, 0),
    ]
    assert {slot.bits for slot in slots} == {8}


def test_fringes_along_both_axes_are_small(maker):
    built = _built(maker, make_patterns(Plan.load("plan_board.yaml"), SIZE, Lattice.DIAMOND))
    assert {image.compression for image in stored_images(built)} == {1, 4}
    assert len(built) - BEHIND_PROGRAM < 300_000


def test_fringes_follow_the_diamond(maker):
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=100, steps=3),))
    image = stored_images(_built(maker, make_patterns(plan, SIZE, Lattice.DIAMOND)))[0]
    columns = np.arange(WIDTH)
    for n, pattern in enumerate(np.moveaxis(image.planes, -1, 0)):
        for row in (0, 1, HEIGHT - 2, HEIGHT - 1):
            place = columns + 0.5 * (row % 2)
            light = 127.5 + 127.5 * np.cos(2 * np.pi * (100 * (place + 0.5) / WIDTH - n / 3))
            assert np.abs(pattern[row] - light).max() <= 0.5 + 1e-9


def test_36_vertical_fringes_are_small(maker):
    built = _built(maker, make_patterns(Plan.load("plan_paper.yaml"), SIZE, Lattice.DIAMOND))
    assert {image.compression for image in stored_images(built)} == {4}
    assert len(built) - BEHIND_PROGRAM == 2060 + 12 * (32 + 4 * 3 * WIDTH)
    assert len(built) - BEHIND_PROGRAM <= 160_000


def test_three_horizontal_fringes_are_as_small_as_the_makers_tool_makes_them(maker):
    plan = Plan(fringes=(Sinusoid(axis="y", stripes=8, steps=3),))
    (image,) = stored_images(_built(maker, make_patterns(plan, SIZE, Lattice.DIAMOND)))
    assert (image.compression, image.stored) == (1, 22_816)


@pytest.fixture(scope="module")
def greys(maker: Path) -> bytes:
    """The maker's firmware with one small image."""
    return _built(maker, uniform_patterns([10, 20, 30], SIZE))


def test_the_program_stays_as_it_is(greys):
    made, built = bytearray(maker_firmware()), bytearray(greys)
    assert struct.unpack("<I", built[SPLASH_ENTRY]) == (0xF9000000 + BEHIND_PROGRAM,)
    made[SPLASH_ENTRY] = built[SPLASH_ENTRY]
    assert built[:BEHIND_PROGRAM] == made[:BEHIND_PROGRAM]


def test_building_on_what_was_built_gives_the_same(greys, tmp_path):
    (tmp_path / "built.bin").write_bytes(greys)
    assert _built(tmp_path / "built.bin", uniform_patterns([10, 20, 30], SIZE)) == greys
    assert (
        _built(tmp_path / "built.bin", uniform_patterns([40], SIZE))[:BEHIND_PROGRAM]
        == greys[:BEHIND_PROGRAM]
    )


def test_images_go_behind_whatever_the_table_lists(tmp_path):
    behind = {**PROGRAM, **IMAGES, 28: (0xF9000000 + 0x170000, 0x100)}
    (tmp_path / "other.bin").write_bytes(maker_firmware(behind))
    built = _built(tmp_path / "other.bin", uniform_patterns([1], SIZE))
    assert struct.unpack("<I", built[SPLASH_ENTRY]) == (0xF9180000,)
    assert built[END:0x180000] == b"\xff" * (0x180000 - END)
    assert (stored_images(built)[0].planes[..., 0] == 1).all()


def test_ten_images_without_repetition_fit_and_eleven_do_not(maker):
    patterns = _noise(31)
    images = stored_images(_built(maker, patterns[:30]))
    assert [image.compression for image in images] == [0] * 10
    assert np.array_equal(images[9].planes[..., 2], patterns[29].image)
    with pytest.raises(ConfigError, match=r"31 patterns take .* bytes of flash and 32112640 are free"):
        _built(maker, patterns)


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("patterns", "words"),
    [
        ([], "no patterns were given"),
        ([GREY] * 769, "769 patterns take 257 images: the flash holds 256"),
        (uniform_patterns([7], (912, 1139)), "pattern grey-007 has 912 x 1139 mirrors"),
    ],
)
def test_patterns_that_the_projector_cannot_hold(maker, patterns, words):
    with pytest.raises(ConfigError, match=words):
        _built(maker, patterns)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is not a firmware"),
        (b"\0" * 0x30000, "is not a firmware"),
        (maker_firmware()[: TABLE + 100], "is not a firmware"),
        (maker_firmware()[TABLE:], "is not a firmware"),
        (maker_firmware()[:0x100000], "block at 0xe0a40 … 0x15efc8, outside .* it is truncated"),
        (maker_firmware({0: (0xF9000000, 99)}), "block at 0x0 … 0x63"),
        (maker_firmware({}), "lists no program"),
        (maker_firmware(end=0x2000001), "has 33554433 bytes, the flash 33554432"),
    ],
    ids=["empty", "zeros", "short", "shifted", "cut off", "in the boot sector", "no program", "too long"],
)
def test_files_that_are_no_firmware(tmp_path, content, words):
    file = tmp_path / "base.bin"
    file.write_bytes(content)
    with pytest.raises(DataError, match=words) as error:
        Firmware.load(file)
    assert str(file) in str(error.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigError, match=r"none.bin: cannot be read"):
        Firmware.load(tmp_path / "none.bin")


def test_a_file_without_images_where_its_table_says(maker):
    with pytest.raises(DataError, match="has no images at 0x15efd0"):
        _ = Firmware.load(maker).images


# --- command --------------------------------------------------------------------------------------


@pytest.mark.whole
def test_the_command(maker, tmp_path):
    out = tmp_path / "out.bin"
    words = ["dlp4500", "build", "plan_paper.yaml", "--base", maker, "--out", out]
    answer = run(*words, "--json").json
    assert (answer["patterns"], answer["images"], answer["firmware"]) == (36 + 26, 21, str(out))
    assert answer["image_bytes"] == out.stat().st_size - BEHIND_PROGRAM
    index = config.load_document(answer["index"], FlashIndex)
    assert (index.patterns[5].id, index.patterns[5].slot) == ("00-x-1-005of12", Slot(1, 2))
    assert {f"grey-{grey:03d}" for grey in (0, 17, 116, 255)} <= {pattern.id for pattern in index.patterns}
    shown = stored_images(out.read_bytes())[1].planes[..., 2]
    assert index.patterns[5].sha256 == hashlib.sha256(shown.tobytes()).hexdigest()
    again = run(*words)
    assert again.code == 2
    assert "exists already" in again.err
    built = out.read_bytes()
    out.unlink()  # as if killed between the two files
    assert run(*words).code == 0
    assert out.read_bytes() == built
    out.unlink()
    index_file = Path(answer["index"])
    index_file.write_text("name: of something else\n")
    refused = run(*words)
    assert refused.code == 2
    assert f"{index_file}: exists already" in refused.err
    assert not out.exists()


@pytest.mark.whole
@pytest.mark.parametrize(
    ("change", "code", "found"),
    [
        ({"--out": "out.img"}, 2, "must end in .bin"),
        ({"--base": "plan.yaml"}, 4, "is not a firmware"),
        ({"--base": "none.bin"}, 2, "cannot be read"),
        ({"plan": "plan.yaml"}, 2, "'fringes[0].stripes' is 457"),
    ],
)
def test_the_command_refuses(maker, tmp_path, change, code, found):
    fringe = {"axis": "x", "stripes": 457, "steps": 3}
    (tmp_path / "plan.yaml").write_text(json.dumps({"fringes": [fringe]}))
    given = {"plan": "plan_paper.yaml", "--base": str(maker), "--out": "out.bin"} | change
    outcome = run(
        "dlp4500", "build", given["plan"], "--base", given["--base"], "--out", given["--out"], cwd=tmp_path
    )
    assert outcome.code == code
    assert found in outcome.err
    assert not (tmp_path / given["--out"]).exists()
