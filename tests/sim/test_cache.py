"""Tables of direct light on disk: reused, never wrong, and failures of the disk never stop a measurement."""

import dataclasses
import errno
import logging
import os
import threading
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import Pattern, make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from sim.light import Light, PatternLevels, SceneState, ShownPattern
from sim.light import cache as module
from sim.light.cache import TableCache
from sim.light.table import LightTable
from sim.worker import Blender
from sim.world import World
from tests.sim.conftest import plain, world

CARD, PILLARS = SceneState("card"), SceneState("pillars")


class Rendering(Exception):  # noqa: N818 - not a fault
    """A picture was asked of Blender."""


class NoBlender(Blender):
    """Stands where Blender would, and renders nothing."""

    def __init__(self) -> None:
        super().__init__("none")

    def render(self, *arguments: Any, **named: Any) -> Any:
        raise Rendering


def fringes(of: World, steps: int = 4, stripes: float = 8) -> tuple[Pattern, ...]:
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=stripes, steps=steps),))
    return tuple(make_patterns(plan, of.projector.size, of.projector.lattice))


def picture(of: World, blender: Blender, cache: TableCache, setup: SceneState = PILLARS) -> PatternLevels:
    return Light(of, blender, cache).irradiance(setup, ShownPattern(fringes(of), 1))


def small_table(seed: int = 0, shape: tuple[int, int] = (6, 5)) -> LightTable:
    random = np.random.default_rng(seed)
    return LightTable(random.random((2, *shape, 4), np.float32), random.random(shape, np.float32))


def same(one: LightTable | None, other: LightTable) -> bool:
    return (
        one is not None
        and np.array_equal(one.samples, other.samples)
        and np.array_equal(one.albedo, other.albedo)
    )


@pytest.fixture
def cache(tmp_path: Path) -> TableCache:
    return TableCache(tmp_path / "light")


@pytest.fixture(scope="module")
def kept(blender: Blender, tmp_path_factory: pytest.TempPathFactory) -> TableCache:
    """A cache that holds the tables of the pillars and the card."""
    store = TableCache(tmp_path_factory.mktemp("kept"))
    for setup in (PILLARS, CARD):
        Light(world(), blender, store).table(setup)
    return store


def needs_render(of: World, store: TableCache, setup: SceneState = PILLARS) -> bool:
    """Whether a new virtual bench of this world has to render."""
    try:
        picture(of, NoBlender(), store, setup)
    except Rendering:
        return True
    return False


# What is found again ---------------------------------------------------------------------------------


def test_a_cached_world_gives_identical_pictures_without_a_render(
    blender: Blender, cache: TableCache
) -> None:
    first = picture(world(), blender, cache)
    again = picture(world(), NoBlender(), cache)
    assert first.max() > 0.5
    np.testing.assert_array_equal(first, again)


def test_blender_does_not_start_where_the_table_is_cached(kept: TableCache) -> None:
    idle = Blender("idle")
    try:
        assert picture(world(), idle, kept).max() > 0.5
        assert idle.pid is None
    finally:
        idle.close()


def projector(**fields: Any) -> dict[str, Any]:
    return {"projector": {**plain()["projector"], **fields}}


def camera(**fields: Any) -> dict[str, Any]:
    return {"camera": {**plain()["camera"], **fields}}


FREE: dict[str, dict[str, Any]] = {
    "response": projector(response={"a": 0.9, "b": 0.05, "g": 2.2}),
    "lumens": projector(leds={"green": {"lumens": 3.0, "wavelength_nm": 525}}),
    "colours": projector(leds={"red": {"lumens": 3.0, "wavelength_nm": 620}}, lit=["red"]),
    "period": projector(period_s=1 / 120),
    "seed": {"seed": 99},
    "ambient": {"ambient": 0.2},
    "vignetting": camera(vignetting=4.0),
    "blur of the projector": projector(blur=0.7),
    "transmission": camera(transmission=0.5),
    "f-number without focus": camera(f_number=8.0),
    "sensor": camera(sensor={"full_well_e": 9000.0, "read_noise_e": 7.0}),
    "shutter": camera(shutter={"line_time_s": 1e-5}),
    "travel": {"stage": {"travel_mm": [-10.0, 10.0]}},
    "path": {"render": {"path": "transport"}},
    "samples": {"render": {"samples": 16}},
    "other items": {"items": {"other": plain()["items"]["card"]}},
}


@pytest.mark.parametrize("change", FREE.values(), ids=FREE.keys())
def test_changes_that_do_not_affect_light_need_no_render(kept: TableCache, change: dict[str, Any]) -> None:
    assert not needs_render(world(**change), kept)


def test_other_patterns_need_no_render(kept: TableCache) -> None:
    of = world()
    light = Light(of, NoBlender(), kept)
    shows = [ShownPattern(fringes(of, steps, stripes), 2) for steps, stripes in ((3, 8), (12, 64.5), (5, 1))]
    shows.append(ShownPattern(tuple(uniform_patterns([0, 255], of.projector.size)), 1))
    pictures = [light.irradiance(PILLARS, show) for show in shows]
    assert all(np.abs(a - b).max() > 0.1 for a, b in pairwise(pictures))


MOVED = {"rotation_deg": [180, 0, 0], "translation_mm": [0, 0, 460.001]}
BOUND: dict[str, dict[str, Any]] = {
    "pose": {"items": {"pillars": {"artefact": "pillars", "pose": MOVED}}},
    "shape": {"items": {"pillars": {**plain()["items"]["pillars"], "artefact": "steps"}}},
    "layers": {"items": {"pillars": {**plain()["items"]["pillars"], "artefact": "pyramid", "layer_mm": 5.0}}},
    "reflectance": {"material": {"reflectance": 0.8}},
    "roughness": {"material": {"roughness": 0.3}},
    "gloss": {"material": {"kind": "glossy", "gloss": 0.1}},
    "ridges": {"material": {"ridges": {}}},
    "grain": {"material": {"grain": {}}},
    "camera's distortion": camera(distortion=[-0.2, 0.3, 0.001, -0.002, 0.051]),
    "camera's centre": camera(centre_offset_px=[1.5, -0.7]),
    "focal length": camera(focal_mm=35.1),
    "pixel": camera(pixel_um=68.5),
    "focus": camera(focus_mm=450.0),
    "projector's pose": projector(
        T_camera_projector={"rotation_deg": [-13.8, -18.1, 2.2], "translation_mm": [150, 0.01, 0]}
    ),
    "projector's distortion": projector(distortion=[-0.05, 0.08, 0.0004, 0.0006, 0.0]),
    "throw ratio": projector(throw_ratio=1.21),
    "lattice": projector(lattice="square"),
    "sharp mirrors": projector(blur=0.0),
    "fill factor": projector(fill_factor=0.9),
    "projector's focus": projector(focus_mm=475.0),
    "distance": projector(distance_mm=480.0),
    "sub-pixels": {"render": {"subpixels": 2}},
}


@pytest.mark.parametrize("change", BOUND.values(), ids=BOUND.keys())
def test_changes_that_affect_light_are_rendered_again(kept: TableCache, change: dict[str, Any]) -> None:
    assert needs_render(world(**change), kept)


def test_another_place_of_the_stage_is_rendered_again(kept: TableCache) -> None:
    assert not needs_render(world(), kept, PILLARS)
    assert needs_render(world(), kept, dataclasses.replace(PILLARS, stage_mm=0.5))


def test_tables_of_displaced_items_are_neither_looked_up_nor_stored(blender: Blender, tmp_path: Path) -> None:
    """A displaced item is never seen again: its table would displace useful ones."""
    store = TableCache(tmp_path / "light")
    assert picture(world(), blender, store, SceneState("pillars", vibration_mm=(0.1, 0.0, 0.0))).max() > 0.5
    assert not (tmp_path / "light").exists()


# What is not what was written ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A file of the cache."""
    folder = tmp_path_factory.mktemp("written")
    TableCache(folder).store("k", small_table())
    return (folder / "k.table").read_bytes()


def discarded(folder: Path, content: bytes, caplog: pytest.LogCaptureFixture) -> str:
    """Load a file of that content, which is refused and removed; return the reason."""
    file = folder / "k.table"
    file.write_bytes(content)
    caplog.clear()
    assert TableCache(folder).load("k") is None
    assert not file.exists()
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    said = record.getMessage()
    assert said.startswith(f"{file}: is discarded and rendered again: ")
    return said


def test_what_is_written_is_read(tmp_path: Path, written: bytes) -> None:
    (tmp_path / "k.table").write_bytes(written)
    assert same(TableCache(tmp_path).load("k"), small_table())


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0, 1, exclude_max=True))
def test_a_truncated_file_is_discarded(
    tmp_path: Path, written: bytes, caplog: pytest.LogCaptureFixture, share: float
) -> None:
    discarded(tmp_path, written[: int(share * len(written))], caplog)


def test_a_file_truncated_anywhere_in_its_header_or_end_is_discarded(
    tmp_path: Path, written: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    head = written.index(b"}\n") + 3
    for length in (*range(head), *range(len(written) - 40, len(written))):
        discarded(tmp_path, written[:length], caplog)


@pytest.mark.parametrize("mask", [0x01, 0x20, 0xFF])
def test_a_changed_byte_anywhere_is_noticed(
    tmp_path: Path, written: bytes, caplog: pytest.LogCaptureFixture, mask: int
) -> None:
    for place in range(len(written)):
        changed = bytearray(written)
        changed[place] ^= mask
        discarded(tmp_path, bytes(changed), caplog)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "it is '', not 'fpplab light table"),
        (b"fpplab light table 1\n{}\n", "it is 'fpplab light table 1', not"),
        (b"\x89PNG\r\n\x1a\n" + bytes(50), "not 'fpplab light table"),
        (b"{}\n", "it is '{}', not"),
    ],
)
def test_a_file_of_another_format_is_discarded(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, content: bytes, why: str
) -> None:
    assert why in discarded(tmp_path, content, caplog)


@pytest.mark.parametrize(
    "about", [b"[]", b"{}", b"3", b"null", b"{", b'{"renderer": "VERSION", "samples": 3, "albedo": [1]}',
              b'{"renderer": "VERSION", "samples": [1.5], "albedo": [1]}',
              b'{"renderer": "VERSION", "samples": [-4, -4], "albedo": [1]}',
              b'{"renderer": "VERSION", "samples": ["x"], "albedo": [1]}',
              b'{"renderer": "VERSION", "samples": [99999999, 99999999], "albedo": [1]}'],
)  # fmt: skip
def test_a_header_of_other_content_is_discarded(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, about: bytes
) -> None:
    """Memory is not allocated for more than the file holds."""
    head = about.replace(b"VERSION", module.renderer_name().encode())
    discarded(tmp_path, f"{module.FORMAT}\n".encode() + head + b"\n" + bytes(200), caplog)


def test_a_file_with_trailing_bytes_is_discarded(
    tmp_path: Path, written: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    assert "checksum" in discarded(tmp_path, written + b"\0", caplog)


def test_the_light_of_another_blender_is_discarded(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as other:
        other.setattr(module, "renderer_name", lambda: "Blender 4.2.0")
        TableCache(tmp_path).store("k", small_table())
        content = (tmp_path / "k.table").read_bytes()
        assert TableCache(tmp_path).load("k") is not None
    assert "was rendered by Blender 4.2.0, not" in discarded(tmp_path, content, caplog)


def test_a_damaged_table_is_rendered_again_and_mended(
    blender: Blender, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    right = picture(world(), blender, TableCache(tmp_path))
    (file,) = tmp_path.iterdir()
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0x40
    file.write_bytes(content)
    assert needs_render(world(), TableCache(tmp_path))
    file.write_bytes(content)
    np.testing.assert_array_equal(picture(world(), blender, TableCache(tmp_path)), right)
    np.testing.assert_array_equal(picture(world(), NoBlender(), TableCache(tmp_path)), right)
    assert caplog.text.count("its checksum is wrong") == 2


# Where it cannot be kept -----------------------------------------------------------------------------


def test_a_full_disk_only_warns(
    blender: Blender, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(stream: BinaryIO, table: LightTable) -> None:
        stream.write(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(module, "_write_table", full)
    assert picture(world(), blender, TableCache(tmp_path / "light")).max() > 0.5
    assert "a table of light cannot be stored in" in caplog.text
    assert "No space left on device" in caplog.text
    assert not list((tmp_path / "light").iterdir()), "half a file is left"


def test_a_directory_that_cannot_be_made_only_warns(
    blender: Blender, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A file stands where the directory would be."""
    (tmp_path / "taken").write_text("mine")
    right = picture(world(), blender, TableCache(tmp_path / "light"))
    np.testing.assert_array_equal(picture(world(), blender, TableCache(tmp_path / "taken")), right)
    assert "a table of light cannot be stored in" in caplog.text
    assert (tmp_path / "taken").read_text() == "mine"


def denied(*arguments: Any, **named: Any) -> None:
    raise PermissionError(errno.EACCES, "Permission denied")


def test_a_directory_of_another_user_only_warns(
    blender: Blender, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module.tempfile, "NamedTemporaryFile", denied)
    assert picture(world(), blender, TableCache(tmp_path)).max() > 0.5
    assert "Permission denied" in caplog.text


def test_read_only_tables_are_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its time cannot be set and it cannot be removed."""
    TableCache(tmp_path).store("k", small_table())
    TableCache(tmp_path).store("broken", small_table())
    (tmp_path / "broken.table").write_bytes(b"what")
    monkeypatch.setattr(os, "utime", denied)
    monkeypatch.setattr(Path, "unlink", denied)
    assert same(TableCache(tmp_path).load("k"), small_table())
    assert not caplog.records
    assert TableCache(tmp_path).load("broken") is None
    assert "is discarded" in caplog.text


def test_a_directory_in_the_place_of_a_file_only_warns(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "k.table").mkdir()
    store = TableCache(tmp_path)
    assert store.load("k") is None
    store.store("k", small_table())
    assert "is discarded" in caplog.text
    assert "a table of light cannot be stored" in caplog.text


def test_without_a_cache_nothing_is_written(
    blender: Blender, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    show = ShownPattern(fringes(world()), 0)
    Light(world(render={"cache": False}), blender).irradiance(CARD, show)
    assert not (tmp_path / "fpplab").exists()  # Blender, starting here, makes a folder of its own
    Light(world(), blender).irradiance(CARD, show)
    assert len(list((tmp_path / "fpplab" / "light").iterdir())) == 1


# How much is kept ------------------------------------------------------------------------------------


def names(folder: Path) -> set[str]:
    return {path.stem for path in folder.iterdir()}


def aged(folder: Path, name: str, seconds: float) -> None:
    """Set the time of last use to so long ago."""
    path = folder / name
    now = path.stat().st_mtime
    os.utime(path, (now - seconds, now - seconds))


def test_the_least_recently_used_are_removed_first(tmp_path: Path, written: bytes) -> None:
    store = TableCache(tmp_path, limit_bytes=3 * len(written))
    for age, key in ((300, "a"), (200, "b"), (100, "c")):
        store.store(key, small_table())
        aged(tmp_path, f"{key}.table", age)
    assert store.load("a") is not None
    store.store("d", small_table())
    assert names(tmp_path) == {"a", "c", "d"}
    store.store("e", small_table())
    assert names(tmp_path) == {"a", "d", "e"}


def test_a_table_greater_than_the_limit_is_not_stored(
    tmp_path: Path, written: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    store = TableCache(tmp_path, limit_bytes=len(written))
    store.store("small", small_table())
    store.store("great", small_table(shape=(60, 50)))
    assert names(tmp_path) == {"small"}
    assert "exceed the cache" in caplog.text


def test_temporary_files_of_killed_processes_are_removed_too(tmp_path: Path, written: bytes) -> None:
    (tmp_path / ".k.table.x8f3").write_bytes(bytes(10 * len(written)))
    aged(tmp_path, ".k.table.x8f3", 1000)
    (tmp_path / "notes.txt").write_text("somebody's own")
    TableCache(tmp_path, limit_bytes=3 * len(written)).store("a", small_table())
    assert {path.name for path in tmp_path.iterdir()} == {"a.table", "notes.txt"}


def test_a_file_that_another_process_removed_is_ignored(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, written: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = TableCache(tmp_path, limit_bytes=len(written))
    store.store("a", small_table())
    listed = list(tmp_path.glob("*.table*"))
    monkeypatch.setattr(
        Path, "glob", lambda self, pattern: [tmp_path / "gone.table", *listed, tmp_path / "b.table"]
    )
    store.store("b", small_table())
    assert not caplog.records
    assert names(tmp_path) == {"b"}


def test_concurrent_readers_never_see_part_of_a_table(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Two writers and two readers of one key: every read gives one of the two tables, complete."""
    tables = [small_table(seed, (120, 100)) for seed in (1, 2)]
    TableCache(tmp_path).store("k", tables[0])
    wrong: list[str] = []

    def write(table: LightTable) -> None:
        for _ in range(15):
            TableCache(tmp_path).store("k", table)

    def read() -> None:
        for _ in range(60):
            found = TableCache(tmp_path).load("k")
            if not any(same(found, table) for table in tables):
                wrong.append("half a table")

    threads = [threading.Thread(target=write, args=(t,)) for t in tables]
    threads += [threading.Thread(target=read) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    assert not caplog.records
    assert names(tmp_path) == {"k"}
