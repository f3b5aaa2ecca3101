"""Each format that is read, written by another program or by its specification: the levels come back."""

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image as Pillow

from fpplab.core.errors import ConfigError, DataError
from fpplab.sessions.image_files import ReadImage, grey_images, places_in
from fpplab.sessions.image_selection import ImageSelection
from fpplab.sessions.importing import read_images

Levels = NDArray[Any]
HEIGHT, WIDTH = 18, 21
G8: Levels = (np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) % 256).astype(np.uint8)
G16: Levels = np.linspace(0, 65535, HEIGHT * WIDTH).round().astype(np.uint16).reshape(HEIGHT, WIDTH)


def read(path: Path) -> ReadImage:
    return next(grey_images(places_in(path)))


def opencv(suffix: str, *options: int) -> Callable[[Levels], bytes]:
    return lambda levels: cv2.imencode(suffix, levels, options)[1].tobytes()


def pillow(form: str, **options: Any) -> Callable[[Levels], bytes]:
    def write(levels: Levels) -> bytes:
        out = io.BytesIO()
        Pillow.fromarray(levels).save(out, form, **options)
        return out.getvalue()

    return write


def tiff(**options: Any) -> Callable[[Levels], bytes]:
    def write(levels: Levels) -> bytes:
        out = io.BytesIO()
        tifffile.imwrite(out, levels, **options)
        return out.getvalue()

    return write


def numpy_file(levels: Levels) -> bytes:
    out = io.BytesIO()
    np.save(out, levels)
    return out.getvalue()


def numpy_archive(levels: Levels) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, levels)
    return out.getvalue()


def netpbm(kind: int, max_level: int) -> Callable[[Levels], bytes]:
    """As netpbm's manual pages describe PGM and PPM, plain (2, 3) and raw (5, 6)."""

    def write(levels: Levels) -> bytes:
        head = b"P%d\n# from a camera\n%d %d\n%d\n" % (kind, levels.shape[1], levels.shape[0], max_level)
        if kind < 4:
            return head + "\n".join(" ".join(map(str, row)) for row in levels.reshape(HEIGHT, -1)).encode()
        return head + levels.astype("u1" if max_level < 256 else ">u2").tobytes()

    return write


def bmp(bits: int, palette: bytes = b"", masks: bytes = b"") -> Callable[[Levels], bytes]:
    """As Microsoft describes BITMAPINFOHEADER: rows from below, each of whole four bytes."""

    def write(levels: Levels) -> bytes:
        row = WIDTH * bits // 8
        padded = np.zeros((HEIGHT, row + -row % 4), np.uint8)
        padded[:, :row] = levels[::-1].reshape(HEIGHT, row)
        info = struct.pack("<IiiHHIIiiII", 40, WIDTH, HEIGHT, 1, bits, 3 if masks else 0, 0, 0, 0, 0, 0)
        start = 14 + len(info) + len(palette) + len(masks)
        head = struct.pack("<2sIHHI", b"BM", start + padded.size, 0, 0, start)
        return head + info + masks + palette + padded.tobytes()

    return write


def packed_tiff(bits: int) -> Callable[[Levels], bytes]:
    """As TIFF 6.0 describes levels of any number of bits: rows of whole bytes, high bits first."""

    def write(levels: Levels) -> bytes:
        single = (levels[..., None] >> np.arange(bits - 1, -1, -1)) & 1
        data = np.packbits(single.astype(np.uint8).reshape(HEIGHT, -1), axis=1).tobytes()
        tags = {
            256: WIDTH,
            257: HEIGHT,
            258: bits,
            259: 1,
            262: 1,
            273: 0,
            277: 1,
            278: HEIGHT,
            279: len(data),
        }
        tags[273] = 8 + 2 + 12 * len(tags) + 4
        entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
        return struct.pack("<2sHIH", b"II", 42, 8, len(tags)) + entries + bytes(4) + data

    return write


def equal(levels: Levels) -> Levels:
    return np.dstack([levels] * 3)


def opaque(levels: Levels) -> Levels:
    return np.dstack([levels] * 3 + [np.full_like(levels, np.iinfo(levels.dtype).max)])


def palette(levels: Levels) -> bytes:
    """Of BMP: blue, green, red and a byte of no meaning for each index."""
    return b"".join(bytes([level, level, level, 0]) for level in levels.tolist())


REVERSED: Levels = np.arange(256)[::-1].astype(np.uint8)
SAME: dict[str, tuple[Callable[[Levels], bytes], Levels, int | None]] = {
    "PNG 8": (opencv(".png"), G8, None),
    "PNG 16": (opencv(".png"), G16, None),
    "PNG 16 by Pillow": (pillow("PNG"), G16, None),
    "TIFF 8": (tiff(), G8, None),
    "TIFF 16": (tiff(), G16, None),
    "TIFF 16 big endian": (tiff(byteorder=">"), G16, None),
    "TIFF 8 LZW": (pillow("TIFF", compression="tiff_lzw"), G8, None),
    "TIFF 16 LZW": (opencv(".tif", cv2.IMWRITE_TIFF_COMPRESSION, 5), G16, None),
    "TIFF 16 deflate": (tiff(compression="zlib", predictor=True), G16, None),
    "TIFF 16 deflate big endian": (tiff(compression="zlib", byteorder=">"), G16, None),
    "TIFF 8 PackBits": (pillow("TIFF", compression="packbits"), G8, None),
    "TIFF 16 tiled": (tiff(tile=(16, 16)), G16, None),
    "TIFF 12 packed": (packed_tiff(12), G16 >> 4, 12),
    "BigTIFF 8": (tiff(bigtiff=True), G8, None),
    "BigTIFF 16": (tiff(bigtiff=True), G16, None),
    "BMP 8": (opencv(".bmp"), G8, None),
    "BMP 8 by Pillow": (pillow("BMP"), G8, None),
    "BMP 8 by hand": (bmp(8, palette(np.arange(256))), G8, None),
    "PGM P5 200": (netpbm(5, 200), G8 % 201, None),
    "PGM P5 255": (opencv(".pgm"), G8, None),
    "PGM P5 1023": (netpbm(5, 1023), G16 >> 6, 10),
    "PGM P5 4095": (netpbm(5, 4095), G16 >> 4, 12),
    "PGM P5 16383": (netpbm(5, 16383), G16 >> 2, 14),
    "PGM P5 65535": (opencv(".pgm"), G16, None),
    "PGM P2 255": (netpbm(2, 255), G8, None),
    "PGM P2 1023": (netpbm(2, 1023), G16 >> 6, 10),
    "PGM P2 4095": (netpbm(2, 4095), G16 >> 4, 12),
    "PGM P2 65535": (opencv(".pgm", cv2.IMWRITE_PXM_BINARY, 0), G16, None),
    "NPY 8": (numpy_file, G8, None),
    "NPY 16": (numpy_file, G16, None),
    "NPZ 16": (numpy_archive, G16, None),
}
EQUAL: dict[str, tuple[Callable[[Levels], bytes], Levels, Callable[[Levels], Levels], int | None]] = {
    "PNG 8": (opencv(".png"), G8, equal, None),
    "PNG 16": (opencv(".png"), G16, equal, None),
    "PNG 8 opaque": (pillow("PNG"), G8, opaque, None),
    "PNG 16 opaque": (opencv(".png"), G16, opaque, None),
    "TIFF 8": (tiff(photometric="rgb"), G8, equal, None),
    "TIFF 16": (tiff(photometric="rgb"), G16, equal, None),
    "TIFF 16 big endian": (tiff(photometric="rgb", byteorder=">"), G16, equal, None),
    "TIFF 16 LZW": (opencv(".tif"), G16, equal, None),
    "TIFF 16 deflate": (tiff(photometric="rgb", compression="zlib", predictor=True), G16, equal, None),
    "TIFF 16 tiled": (tiff(photometric="rgb", tile=(16, 16)), G16, equal, None),
    "TIFF 16 opaque": (opencv(".tif"), G16, opaque, None),
    "BMP 24": (opencv(".bmp"), G8, equal, None),
    "BMP 24 by hand": (bmp(24), G8, equal, None),
    "BMP 32": (bmp(32), G8, opaque, None),
    "BMP 32 with masks": (bmp(32, masks=struct.pack("<III", 0xFF0000, 0xFF00, 0xFF)), G8, opaque, None),
    "PPM P6 255": (opencv(".ppm"), G8, equal, None),
    "PPM P6 4095": (netpbm(6, 4095), G16 >> 4, equal, 12),
    "PPM P6 65535": (opencv(".ppm"), G16, equal, None),
    "PPM P3 1023": (netpbm(3, 1023), G16 >> 6, equal, 10),
}


@pytest.mark.parametrize(("write", "levels", "bits"), SAME.values(), ids=SAME.keys())
def test_levels_come_back(
    tmp_path: Path, write: Callable[[Levels], bytes], levels: Levels, bits: int | None
) -> None:
    path = tmp_path / "image.dat"
    path.write_bytes(write(levels))
    image = read(path)
    np.testing.assert_array_equal(image.levels, levels)
    assert image.levels.dtype == levels.dtype
    assert (image.is_lossy, image.stated_bits) == (False, bits)


@pytest.mark.parametrize(("write", "levels", "repeat", "bits"), EQUAL.values(), ids=EQUAL.keys())
def test_equal_channels_are_grey(
    tmp_path: Path,
    write: Callable[[Levels], bytes],
    levels: Levels,
    repeat: Callable[[Levels], Levels],
    bits: int | None,
) -> None:
    path = tmp_path / "image.dat"
    path.write_bytes(write(repeat(levels)))
    image = read(path)
    np.testing.assert_array_equal(image.levels, levels)
    assert image.levels.dtype == levels.dtype
    assert image.stated_bits == bits


def test_levels_are_those_of_a_grey_palette(tmp_path: Path) -> None:
    path = tmp_path / "image.bmp"
    path.write_bytes(bmp(8, palette(REVERSED))(G8))
    np.testing.assert_array_equal(read(path).levels, REVERSED[G8])
    indexed = Pillow.fromarray(G8).convert("P")
    indexed.putpalette(np.repeat(REVERSED, 3).tobytes())
    indexed.save(path, "PNG")
    np.testing.assert_array_equal(read(path).levels, REVERSED[G8])


def test_pages_of_deep_colour_are_told_apart(tmp_path: Path) -> None:
    pages = np.array([equal(G16), equal(G16 // 3)])
    tifffile.imwrite(tmp_path / "stack.tif", pages, photometric="rgb")
    levels = [image.levels for image in grey_images(places_in(tmp_path / "stack.tif"))]
    np.testing.assert_array_equal(levels, pages[..., 0])


def test_a_jpeg_picture_is_read_and_lossy(tmp_path: Path) -> None:
    for channels in (G8, equal(G8)):
        (tmp_path / "a.jpg").write_bytes(opencv(".jpg", cv2.IMWRITE_JPEG_QUALITY, 100)(channels))
        image = read(tmp_path / "a.jpg")
        assert image.is_lossy
        assert np.abs(image.levels.astype(int) - G8).max() <= 3


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
@pytest.mark.parametrize("place", ["low", "high"])
@pytest.mark.parametrize("write", [opencv(".png"), tiff(), opencv(".pgm"), numpy_file])
def test_depths(tmp_path: Path, write: Callable[[Levels], bytes], bits: int, place: str) -> None:
    levels = G16 >> (16 - bits)
    (tmp_path / "0.dat").write_bytes(write(levels << (16 - bits) if place == "high" else levels))
    images, depth = read_images(ImageSelection((tmp_path / "0.dat",)))
    assert depth == bits
    np.testing.assert_array_equal(images[0], levels)


def test_the_head_of_a_pgm_file_states_the_depth(tmp_path: Path) -> None:
    dark = ImageSelection((tmp_path / "0.pgm",))
    (tmp_path / "0.pgm").write_bytes(netpbm(5, 4095)(G16 >> 8))
    assert read_images(dark)[1] == 12
    assert read_images(dark, 10)[1] == 10
    with pytest.raises(ConfigError, match=r"--bits is 16, but .*0\.pgm states that its levels have 12 bits"):
        read_images(dark, 16)
    (tmp_path / "1.pgm").write_bytes(netpbm(5, 1023)(G16 >> 9))
    with pytest.raises(DataError, match=r"state 12 bits \(0\.pgm\) and 10 bits \(1\.pgm\)"):
        read_images(ImageSelection((tmp_path / "0.pgm", tmp_path / "1.pgm")))


COLOUR: Levels = np.dstack([G8 // 8, G8, G8 // 2])


def grey_of(bits: int, data: bytes) -> bytes:
    """A grey PNG picture of few bits, as its specification says."""
    chunks = {
        b"IHDR": struct.pack(">IIBBBBB", WIDTH, HEIGHT, bits, 0, 0, 0, 0),
        b"IDAT": zlib.compress(data),
        b"IEND": b"",
    }
    parts = (
        struct.pack(">I", len(d)) + n + d + struct.pack(">I", zlib.crc32(n + d)) for n, d in chunks.items()
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def zipped() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("00.png", opencv(".png")(G8))
    return out.getvalue()


REFUSED: dict[str, tuple[bytes, str]] = {
    "colour": (
        pillow("PNG")(COLOUR),
        r"is in colour: its channels differ by up to 224 grey levels \(mean red \d+\.\d, green \d+\.\d, blue "
        r".* save the green channel",
    ),
    "colour of 16 bits": (
        tiff(photometric="rgb")(COLOUR * np.uint16(257)),
        "is in colour.* the green channel",
    ),
    "colour in JPEG": (pillow("JPEG")(COLOUR), "is in colour"),
    "colour in PPM": (netpbm(6, 255)(COLOUR), "is in colour"),
    "transparent": (pillow("PNG")(np.dstack([G8, G8])), "is transparent in part"),
    "float": (tiff()(G8.astype(np.float32)), r"holds floating-point numbers of 32 bits; .*8- or 16-bit grey"),
    "double": (tiff()(G8.astype(np.float64)), r"holds floating-point numbers of 64 bits"),
    "32 bits": (tiff()(G8.astype(np.uint32)), r"holds 32-bit integers; export it as 8- or 16-bit grey"),
    "signed 32 bits": (tiff()(G8.astype(np.int32)), r"holds signed integers of 32 bits"),
    "signed 8 bits": (tiff()(G8.astype(np.int8)), r"holds signed integers of 8 bits"),
    "packed 10 bits": (
        packed_tiff(10)(G16 >> 6),
        r"holds levels of 10 bits in a form that is not read \(TIFF, ch",
    ),
    "big-endian BigTIFF": (
        tiff(bigtiff=True, byteorder=">")(G16),
        r"16 bits in a form .* \(big-endian BigTIFF",
    ),
    "deep colour in planes": (
        tiff(photometric="rgb", planarconfig="separate")(np.stack([G16] * 3)),
        r"holds 16-bit colours in separate planes",
    ),
    "1 bit": (pillow("PNG")(G8 > 99), r"holds 1-bit pixels"),
    "4 bits": (grey_of(4, bytes(HEIGHT * (1 + (WIDTH + 1) // 2))), r"holds 4-bit levels"),
    "inks": (tiff(photometric="separated")(np.dstack([G8] * 4)), r"holds inks \(CMYK\)"),
    "BMP of 16 bits": (bmp(16)(np.dstack([G8, G8])), r"holds 15-bit levels"),
    "PBM": (b"P4\n8 1\n\x0f", r"holds 1-bit pixels \(PBM\)"),
    "PFM": (b"Pf\n1 1\n-1.0\n\0\0\0\0", r"holds floating-point numbers \(PFM\)"),
    "level beyond": (netpbm(5, 4095)(G16), r"it has a level of 65535, and its head says 4095 at most"),
    "cut off": (netpbm(5, 255)(G8)[:-3], r"is truncated or damaged \(bytes fewer .*: 3\)"),
    "two in one": (netpbm(5, 255)(G8) * 2, r"bytes more than its head says: \d+"),
    "AVI": (b"RIFF\x24\0\0\0AVI LIST", r"is a video \(AVI\); save single images as PNG or TIFF"),
    "MP4": (b"\0\0\0\x20ftypisom\0\0\2\0", r"is a video \(MP4 or QuickTime\)"),
    "MKV": (b"\x1a\x45\xdf\xa3\x01\0\0\0", r"is a video \(Matroska or WebM\)"),
    "WMV": (bytes.fromhex("3026b2758e66cf11a6d900aa0062ce6c"), r"is a video \(WMV\)"),
    "PDF": (b"%PDF-1.7\n%\xe2\xe3", r"is a PDF document"),
    "HTML": (b"\n<!DOCTYPE html>\n<html>", r"is a page in HTML"),
    "SVG": (b'<?xml version="1.0"?>\n<svg width="1">', r"is an SVG drawing"),
    "GIF": (pillow("GIF")(G8), r"is a GIF picture"),
    "WebP": (pillow("WEBP", lossless=True)(equal(G8)), r"is a WebP picture"),
    "HEIF": (b"\0\0\0\x18ftypheic\0\0\0\0", r"is a HEIF picture"),
    "JPEG 2000": (pillow("JPEG2000")(G8), r"is a JPEG 2000 picture"),
    "CR2": (b"II*\0\x10\0\0\0CR\2\0", r"is a camera's raw file \(CR2\)"),
    "DNG": (
        tiff(extratags=[(50706, 1, 4, (1, 4, 0, 0))])(G16),
        r"is a camera's raw file \(DNG or the like\)",
    ),
    "ZIP": (zipped(), r"is a ZIP archive without an array; unpack it"),
    "MATLAB": (b"MATLAB 5.0 MAT-file, Platform: PCWIN64".ljust(200), r"is a MATLAB file"),
    "HDF5": (b"\x89HDF\r\n\x1a\n\0\0", r"is an HDF5 file"),
    "text": ("Graustufen für später".encode(), r"is a text file;"),
    "nothing": (b"", r"is empty"),
    "noise": (bytes(range(128, 200)), r"is no image: it begins with 80 81 82"),
}


@pytest.mark.parametrize(("content", "complaint"), REFUSED.values(), ids=REFUSED.keys())
def test_what_is_not_grey_is_named(tmp_path: Path, content: bytes, complaint: str) -> None:
    path = tmp_path / "image.png"
    path.write_bytes(content)
    with pytest.raises(DataError, match=complaint) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_palette_of_colours(tmp_path: Path) -> None:
    indexed = Pillow.fromarray(G8).convert("P")
    indexed.putpalette(np.dstack([REVERSED, REVERSED, REVERSED // 2]).tobytes())
    for form, complaint in {
        "PNG": "is in colour",
        "BMP": "is in colour",
        "TIFF": "a palette of colours",
    }.items():
        indexed.save(tmp_path / "image", form)
        with pytest.raises(DataError, match=complaint):
            read(tmp_path / "image")
