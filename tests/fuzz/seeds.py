"""What the fuzzer begins with: files as fpplab and others write them, and what has failed before.

What guides a target is imported where its seeds are made, for only then are its branches watched.
"""

import io
import json
import tempfile
from functools import cache
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
KINDS = ("calibration", "dataset", "plan", "rig", "standard", "study", "target", "world")
KEPT = Path(__file__).with_name("corpus")
"""By target, inputs that once failed or that reach code which others do not."""


def kept(target: str) -> list[bytes]:
    """Inputs that are kept with the sources."""
    return [path.read_bytes() for path in sorted((KEPT / target).glob("*"))]


def yaml() -> list[bytes]:
    files = [(k, path) for k, kind in enumerate(KINDS) for path in sorted(CONFIGS.glob(f"{kind}_*.yaml"))]
    return [bytes([k]) + path.read_bytes() for k, path in files]


def odd_yaml() -> list[bytes]:
    odd = (
        b"a: &a [1, 1]\nb: *a\n",
        b"? [a]\n: 1\n",
        b"a: !!bool maybe\n",
        b"a: 0x1F\nb: 1_000\nc: 2001-01-01\n",
    )
    return [bytes([3]) + text for text in odd]


def calibration() -> list[bytes]:
    return [path.read_bytes() for path in sorted(CONFIGS.glob("calibration_*.yaml"))]


@cache
def session_files() -> dict[str, bytes]:
    """The files of a small session by their place in it."""
    from fpplab.core.checksums import write_recorded
    from tests.support.recorded import record

    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "session"
        record(place)
        write_recorded(
            place / "rig.yaml", "name: bench\nresolved: {projector: {size: [64, 48], lattice: square}}\n"
        )
        return {p.relative_to(place).as_posix(): p.read_bytes() for p in place.rglob("*") if p.is_file()}


def session() -> list[bytes]:
    return [bytes([k]) + content for k, (_, content) in enumerate(sorted(session_files().items()))]


@cache
def cloud() -> list[bytes]:
    from fpplab.clouds import CLOUD_SUFFIXES, Cloud, save_cloud

    points = np.arange(12, dtype=np.float32).reshape(4, 3)
    pixels = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.int32)
    whole = Cloud(points, pixels, (2, 2), sigma_noise_mm=np.full(4, 0.1, np.float32))
    text = "ply\nformat ascii 1.0\nelement vertex 1\n" + "".join(f"property float {c}\n" for c in "xyz")
    found = [b"\0" + text.encode() + b"end_header\n1 2 3\n"]
    with tempfile.TemporaryDirectory() as folder:
        for k, suffix in enumerate(CLOUD_SUFFIXES):
            save_cloud(whole, Path(folder) / f"cloud{suffix}")
            found.append(bytes([k]) + (Path(folder) / f"cloud{suffix}").read_bytes())
    table = CLOUD_SUFFIXES.index(".xyz")
    texts = (b"1 2 3\n4 5 6\n", b"# x y z\n1.5 2.5 3e2\n", b"1 2 3 10 20 30\n4 5 6 4 5 6\n", b"1\t2\t3\r\n")
    return found + [bytes([table]) + text for text in texts]


def decoded() -> list[bytes]:
    out = io.BytesIO()
    maps = dict.fromkeys(("u", "v", "modulation", "sigma"), np.ones((2, 3), np.float32))
    np.savez(out, v_per_u=np.asarray(1.0), **maps)
    return [out.getvalue()]


def mesh() -> list[bytes]:
    import trimesh

    box = trimesh.creation.box((1, 2, 3))
    kinds = ("stl", "ply", "obj")
    found = [bytes([k]) + _bytes(box.export(file_type=kind)) for k, kind in enumerate(kinds)]
    return found + [
        b"\0" + _bytes(box.export(file_type="stl_ascii")),
        b"\1" + _bytes(box.export(file_type="ply", encoding="ascii")),
    ]


def _bytes(content: str | bytes) -> bytes:
    return content.encode() if isinstance(content, str) else content


def opencv() -> list[bytes]:
    found = []
    for kind in (cv2.FILE_STORAGE_FORMAT_YAML, cv2.FILE_STORAGE_FORMAT_XML):
        storage = cv2.FileStorage("", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | kind)
        for name, fy in (("M1", 900.0), ("M2", 1800.0)):  # of a camera, and of a diamond lattice
            storage.write(name, np.array([[900.0, 0, 320], [0, fy, 240], [0, 0, 1]]))
        for name in ("D1", "D2"):
            storage.write(name, np.zeros((1, 5)))
        storage.write("R", np.eye(3))
        storage.write("T", np.array([[100.0], [0], [0]]))
        storage.write("lattice2", "diamond")
        found.append(storage.releaseAndGetString().encode())
    return found


DIALECTS = (".yaml", ".json", ".npz", ".mat", ".cameramodel")
"""Suffixes of calibrations by other programs: whole in one file, and of the last one with a device each."""


def dialect() -> list[bytes]:
    """Calibrations as Kalibr, Python's and NumPy's writers and MATLAB make them, each in one file."""
    import yaml
    from scipy.io import savemat

    from tests.calibration.test_dialects import PROCAM, STEREO, camchain

    rows = {name: values.tolist() for name, values in STEREO.items()}
    npz, mat = io.BytesIO(), io.BytesIO()
    np.savez(npz, **STEREO)
    savemat(mat, STEREO)
    sized = {"img_shape": [912, 1368], **{name: values.tolist() for name, values in PROCAM.items()}}
    parts = (
        (0, yaml.safe_dump(camchain()).encode()),
        (0, yaml.safe_dump(rows).encode()),
        (1, json.dumps(rows).encode()),
        (1, json.dumps(sized).encode()),
        (2, npz.getvalue()),
        (3, mat.getvalue()),
    )
    return [bytes([kind]) + content for kind, content in parts]


def odd_dialects() -> list[bytes]:
    """Files of one device, which are refused by themselves."""
    from tests.calibration.test_dialects import D1, K1, mrcal

    model = mrcal("LENSMODEL_OPENCV5", K1, D1, "'extrinsics': [ 0, 0, 0, 0, 0, 0,]", (1368, 912))
    return [bytes([4]) + model.encode()]


def image() -> list[bytes]:
    from PIL import Image as Pillow

    levels = np.arange(48, dtype=np.uint8).reshape(6, 8)
    found = []
    for picture in (levels, levels.astype(np.uint16) * 1000):
        for kind in ("PNG", "TIFF", "PPM", *(("JPEG", "BMP") if picture.dtype == np.uint8 else ())):
            out = io.BytesIO()
            Pillow.fromarray(picture).save(out, kind)
            found.append(out.getvalue())
        out = io.BytesIO()
        np.save(out, np.stack([picture, picture + 1]))
        found.append(out.getvalue())
    out = io.BytesIO()
    np.savez_compressed(out, levels)
    head = b"%s\n# by hand\n8 6\n%d\n"
    plain = b" ".join(b"%d" % level for level in levels.flat)
    grey = (head % (b"P5", 255) + levels.tobytes(), head % (b"P2", 255) + plain, head % (b"P2", 4095) + plain)
    wide = head % (b"P5", 4095) + levels.astype(">u2").tobytes()
    equal = head % (b"P6", 255) + np.repeat(levels[..., None], 3, axis=2).tobytes()
    return [*found, out.getvalue(), *grey, wide, equal]


def records() -> list[bytes]:
    files = session_files()
    return [bytes([k]) + text for k, text in enumerate((files["journal.jsonl"], files["files.jsonl"]))]


def odd_records() -> list[bytes]:
    card = {
        "format": "fpplab dataset 1",
        "fields": [{"name": "frames"}],
        "shard_size": 2,
        "shards": 1,
        "samples": 2,
    }
    texts = (json.dumps(card).encode(), b'{"frames.npy": "00"}', b'{"epoch": 1}\n')
    return [bytes([k]) + text for k, text in enumerate(texts, 2)]


def hid() -> list[bytes]:
    from drivers.dlp4500.protocol import COMMANDS

    found = []
    for command in COMMANDS.values():
        for flags in (0xC0, 0x40):
            payload = command.number.to_bytes(2, "little")
            found.append((bytes([flags, 1]) + len(payload).to_bytes(2, "little") + payload).ljust(64, b"\0"))
    return found


def grbl() -> list[bytes]:
    from tests.drivers.test_stage_lines import LINES

    asked = (b"$H\nG90 G21 G53 G0 X-5\n?", b"$$\n$I\n", b"\x18G4P0\nY-2\n!")
    return [*asked, *(line.encode() + b"\n" for line in LINES)]


@cache
def firmware() -> bytes:
    """A flash file with three patterns."""
    from drivers.dlp4500.flash.firmware import Firmware
    from fpplab.core.conventions import Lattice
    from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
    from fpplab.patterns.fringes import make_patterns
    from fpplab.patterns.plan import Plan
    from tests.drivers.flash_files import maker_firmware

    patterns = make_patterns(
        Plan(fringes=(Sinusoid(axis="x", stripes=1, steps=3),)), (912, 1140), Lattice.DIAMOND
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "maker.bin"
        file.write_bytes(maker_firmware())
        return bytes(Firmware.load(file).with_patterns(patterns, file).content)


def unchanged_firmware() -> list[bytes]:
    return [b""]


def firmware_changes() -> list[bytes]:
    return [b"\x00" * 5, b"\xff\xff\xff\xff\x80", *(bytes([k, 0, 2, 0, 255]) for k in range(0, 250, 50))]
