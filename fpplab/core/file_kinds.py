"""What a file or folder is, by its content: a refusal names it, and says what belongs in its place."""

import io
import re
import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import open_regular
from fpplab.core.session_names import FRAMES, JOURNAL, PLAN
from fpplab.core.signatures import kind_of

WantedKind = Literal[
    "calibration", "cloud", "dataset", "foreign calibration", "limits", "maps", "mesh", "plan", "points",
    "response", "rig", "session", "standard", "study", "tables", "target", "world",
]  # fmt: skip

_HEAD_BYTES = 1 << 18  # how much of a file is looked at (chosen): files of settings are smaller

RIG, PLAN_FILE, TARGET, WORLD = "a rig file", "a plan", "a target file", "a world file of a twin"
CALIBRATION, RESPONSE, LIMITS = "a calibration of fpplab", "a response file", "a file of limits"
STANDARD, STUDY, DATASET = "a standard file", "a study file", "a file of ranges for a data set"
SESSION, ANSWER, TABLE = "a session", "an answer of `--json`", "a table of numbers"
IMAGES = "a folder of images"
PLY, PLY_MESH, STL, OBJ = "a PLY file of points", "a PLY file with faces", "an STL mesh", "an OBJ mesh"
JOURNAL_FILE, NPZ_CLOUD, MAPS = "a journal of fpplab", "a cloud as NPZ", "an NPZ file of decoded maps"
OPENCV, KALIBR, ROS = "a file of OpenCV's FileStorage", "a camchain of Kalibr", "a calibration of ROS"
MRCAL, MATLAB, NPZ_CALIBRATION = "a camera model of mrcal", "a MATLAB file", "a calibration as NPZ"
JSON, JSON_CALIBRATION = "a JSON file", "a calibration as JSON"
FOREIGN_CALIBRATIONS = (OPENCV, KALIBR, ROS, MRCAL, MATLAB, NPZ_CALIBRATION, JSON_CALIBRATION)

_WANTED: dict[WantedKind, tuple[tuple[str, ...], str]] = {
    "calibration": ((CALIBRATION,), "a calibration, which `fpplab characterise` writes"),
    "cloud": (
        (PLY, PLY_MESH, TABLE, NPZ_CLOUD, SESSION),
        "a cloud (.ply, .npz or a table: .xyz, .csv, .txt, .pts, .asc), which `fpplab reconstruct` writes",
    ),
    "dataset": ((DATASET,), "a file of ranges, such as dataset_demo"),
    "foreign calibration": (
        (*FOREIGN_CALIBRATIONS, CALIBRATION),
        "a calibration: fpplab's own, or one of OpenCV, Kalibr, ROS, mrcal or MATLAB",
    ),
    "limits": ((LIMITS,), "a file of limits (docs/verdicts.md)"),
    "maps": ((MAPS,), "decoded maps, which `fpplab decode` writes"),
    "mesh": ((STL, PLY_MESH, OBJ), "a mesh of the true shape (.stl, .ply, .obj)"),
    "plan": ((PLAN_FILE,), "a plan, such as plan_paper; `fpplab plan guess` writes one from images"),
    "points": ((TABLE,), "a table of a board's points as text, whose first row names its columns"),
    "response": ((RESPONSE,), "a response file, which `fpplab gamma` writes"),
    "rig": ((RIG,), "a rig file, such as rig_demo_quick; `fpplab rig new` writes one"),
    "session": (
        (SESSION,),
        "a session, the folder that `fpplab scan` leaves; `fpplab import` makes one of images",
    ),
    "standard": ((STANDARD,), "a standard file, such as standard_demo"),
    "study": ((STUDY,), "a study file, such as study_baseline"),
    "tables": ((ANSWER, JSON, JOURNAL_FILE), "an answer of `--json` or a journal (.jsonl)"),
    "target": ((TARGET,), "a target file, such as target_paper"),
    "world": ((WORLD,), "a world file, such as world_demo"),
}
"""The kinds of files that may be what is wanted, and what to ask for instead of others."""

_BY_KEYS: tuple[tuple[str, str], ...] = (
    (CALIBRATION, "T_projector_camera"),
    (STUDY, "objectives space"),
    (DATASET, "artefacts variation"),
    (STANDARD, "mpe_um evaluation"),
    (STANDARD, "ball_bar"),
    (WORLD, "items camera"),
    (PLAN_FILE, "fringes"),
    (TARGET, "kind counts"),
    (RESPONSE, "levels measured"),
    ("a verdict that a session holds", "verdict findings"),
    (KALIBR, "cam0"),
    (ROS, "distortion_model"),
    (ROS, "child_frame_id transform"),
    (LIMITS, "criteria"),
    (LIMITS, "verdict"),
    (LIMITS, "plan_check"),
    (LIMITS, "max_residual_sigmas"),
)
_IN_TEXT: tuple[tuple[str, str], ...] = (
    (CALIBRATION, r"^camera:\s.*\bfocal_px\b"),
    (RIG, r"^(camera|projector):\s.*\bbackend\b"),
    (OPENCV, r"^(%YAML|<\?xml[^>]*>\s*<opencv_storage)|!!opencv|\"type_id\": *\"opencv"),
    (MRCAL, r"^\{\s*['\"]lensmodel['\"]"),
)
_JSON_KEYS = re.compile(r'"(\w+)"\s*:')
_CALIBRATION_NAMES = {"M1", "K1", "R", "camera_matrix", "cameraMatrix", "cam_int", "mtx", "mtxL", "K"}

_STARTS: dict[bytes, str] = {
    b"\x89PNG": "a PNG picture",
    b"\xff\xd8\xff": "a JPEG picture",
    b"II*\x00": "a TIFF picture",
    b"MM\x00*": "a TIFF picture",
    b"BM": "a BMP picture",
    b"\x93NUMPY": "an array of NumPy",
    b"RRF": "a recording of the viewer",
    b"BLENDER": "a file of Blender",
    b"LASF": "a LAS cloud",
    b"# .PCD": "a PCD cloud",
    b"ASTM-E57": "an E57 cloud",
    b"OFF": "an OFF mesh",
    b"ISO-10303-21": "a STEP model, which the program that drew it can export as STL",
    b"\x7fELF": "a program",
    b"MZ": "a program",
    b"SQLite format 3": "a database of SQLite",
}


_SUFFIXES = {PLY: ".ply", PLY_MESH: ".ply", NPZ_CLOUD: ".npz", STL: ".stl", OBJ: ".obj"}
"""Suffixes by which readers choose, of kinds that they may be given under another one."""


def describe_file(path: Path) -> str | None:
    """Name what a file or folder is, with its article; None where nothing tells."""
    try:
        if path.is_dir():
            return _describe_folder(path)
        with open_regular(path) as stream:
            head = stream.read(_HEAD_BYTES)
            size = path.stat().st_size
            content = head + stream.read() if head.startswith(b"PK\x03\x04") else b""
    except OSError:
        return None
    if content:
        return _describe_archive(content)
    if not head:
        return "empty"
    if b'<meta name="generator" content="fpplab">' in head[:1024]:
        return "a report of fpplab"
    if head.startswith(b"ply"):
        return PLY_MESH if re.search(rb"element face [1-9]", head) else PLY
    if len(head) >= 84 and size == 84 + 50 * int.from_bytes(head[80:84], "little"):
        return STL
    if re.match(rb"P[1-7]\s", head):
        return "a PGM or PPM picture"
    if _is_matlab_4(head):
        return MATLAB
    start = next((kind for start, kind in _STARTS.items() if head.startswith(start)), None)
    kind = start or kind_of(head)
    return _describe_text(head) if kind is None or kind.startswith("a text file") else kind


def _is_matlab_4(head: bytes) -> bool:
    """Whether a file begins as one of MATLAB's version 4: type, rows, columns, flag, and a name."""
    if len(head) < 22:
        return False
    form, rows, columns, is_complex, length = struct.unpack("<5i", head[:20])
    name = head[20 : 20 + max(length, 0)]
    sizes_fit = form in range(0, 60, 10) and rows > 0 and columns > 0 and is_complex in (0, 1)
    return sizes_fit and 1 < length < 64 and name[-1:] == b"\0" and name[:-1].isalnum()


def _describe_folder(path: Path) -> str:
    inside = list(path.iterdir())
    names = {each.name for each in inside}
    if JOURNAL in names or {PLAN, FRAMES} <= names:
        return SESSION
    if any((each / JOURNAL).is_file() for each in inside if each.is_dir()):
        return "a folder of sessions"
    suffixes = {each.suffix.lower() for each in inside}
    if suffixes & {".png", ".tif", ".tiff", ".bmp", ".pgm", ".jpg", ".jpeg"}:
        return IMAGES
    return "a folder without a session" if inside else "an empty folder"


def _describe_archive(content: bytes) -> str | None:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            names = archive.namelist()
    except Exception:  # noqa: BLE001 - the unpacker raises exceptions of any kind
        return None
    arrays = [name.removesuffix(".npy") for name in names if name.endswith(".npy")]
    if "3D/3dmodel.model" in names:
        return "a 3MF mesh"
    if not arrays:
        return "a ZIP archive"
    if "points" in arrays:
        return NPZ_CLOUD
    if {"u", "v"} <= set(arrays):
        return MAPS
    if _CALIBRATION_NAMES & set(arrays):
        return NPZ_CALIBRATION
    return f"an NPZ file of {', '.join(arrays[:6])}"


def _describe_text(head: bytes) -> str | None:
    try:
        text = head.decode("utf-16" if head[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig", "strict")
    except UnicodeDecodeError as error:
        if len(head) < _HEAD_BYTES or error.start < len(head) - 4:
            return None
        text = head[: error.start].decode("utf-8-sig")
    start = text.lstrip()
    if start.startswith("solid") and "facet" in text:
        return STL
    for kind, pattern in _IN_TEXT:
        if re.search(pattern, start, re.MULTILINE | (re.DOTALL if kind in (CALIBRATION, RIG) else 0)):
            return kind
    if start.startswith(("{", "[")):
        return _describe_json(text)
    keys = set(re.findall(r"^([A-Za-z_]\w*)\s*:(?:\s|$)", text, re.MULTILINE))
    for kind, needed in _BY_KEYS:
        if keys.issuperset(needed.split()):
            return kind
    if keys & _CALIBRATION_NAMES:
        return OPENCV
    return None if keys else _describe_lines(text)


def _describe_json(text: str) -> str | None:
    names = set(_JSON_KEYS.findall(text))
    if not names:
        return None
    if names & _CALIBRATION_NAMES:
        return JSON_CALIBRATION
    lines = text.splitlines()
    if len(lines) > 1 and lines[0].startswith("{") and lines[0].endswith("}"):
        return JOURNAL_FILE
    return ANSWER if names & {"verdict", "exit_code", "file", "session"} else JSON


def _describe_lines(text: str) -> str | None:
    lines = [line.strip() for line in text.splitlines()[:200]]
    lines = [line for line in lines if line and not line.startswith(("#", "//"))]
    if any(re.match(r"v\s+[-\d]", line) for line in lines):
        return OBJ if re.search(r"^f\s+\d", text, re.MULTILINE) else "an OBJ file without faces"
    values = [[word for word in re.split(r"[\s,;]+", line) if word] for line in lines[1:6]]
    is_number = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)?|[-+]?nan", re.IGNORECASE)
    if values and all(len(row) >= 3 and all(map(is_number.fullmatch, row)) for row in values):
        return TABLE
    return None


def other_kind(path: Path, wanted: WantedKind) -> str | None:
    """Say that a file or folder is of another kind than wanted; None where it may be of that kind."""
    kind = describe_file(path)
    accepted, needed = _WANTED[wanted]
    suffix = _SUFFIXES.get(kind or "", "")
    if kind in accepted and suffix and path.suffix.lower() != suffix:
        return f"{path}: is {kind}, whose name must end in {suffix}"
    if kind is None or kind in accepted:
        return None
    if wanted == "foreign calibration" and path.is_dir():
        return f"{path}: is a folder; name the files of the calibration in it"
    if wanted == "calibration" and kind in FOREIGN_CALIBRATIONS:
        return f"{path}: is {kind}; `fpplab convert` makes a calibration of fpplab of it"
    return f"{path}: is {kind}; expected {needed}"


@contextmanager
def naming_other_kinds(path: Path, wanted: WantedKind) -> Iterator[None]:
    try:
        yield
    except (ConfigError, DataError) as error:
        if sentence := other_kind(path, wanted):
            raise type(error)(sentence) from error
        raise
