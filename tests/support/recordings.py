"""Recordings of rerun read back, by entity and component; versions 0.23 and 0.41 read them differently."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from PIL import Image as Pixels


class Recording:
    """A recording file."""

    def __init__(self, path: Path) -> None:
        self._file = _Views(path) if hasattr(rr, "dataframe") else _Chunks(path)

    def entities(self) -> set[str]:
        """All entities."""
        return self._file.entities()

    def frames(self, entity: str, index: str = "frame") -> list[int]:
        """When an entity was logged."""
        return self._file.frames(entity, index)

    def value(self, entity: str, component: str, row: int | None = None, index: str = "frame") -> Any:
        """What was logged: static, or in one row."""
        found = self._file.rows(entity, component, None if row is None else index)[row or 0]
        return found if len(found) > 1 else found[0]

    def jpeg(self, entity: str, row: int) -> NDArray[np.int64]:
        """A compressed picture."""
        data = bytes(self.value(entity, "Blob", row))
        return np.asarray(Pixels.open(io.BytesIO(data)).convert("L")).astype(np.int64)

    def rgb(self, entity: str, row: int | None = None) -> NDArray[np.int64]:
        """A coloured map (h, w, 3)."""
        form = self.value(entity, "ImageFormat", row)
        data = self.value(entity, "ImageBuffer", row)
        values = np.frombuffer(data, np.uint8) if isinstance(data, bytes) else np.array(data)
        return values.reshape(form["height"], form["width"], 3).astype(np.int64)


class _Views:
    """By the data frames of rerun 0.23."""

    def __init__(self, path: Path) -> None:
        self._data = rr.dataframe.load_recording(path)

    def entities(self) -> set[str]:
        return {column.entity_path for column in self._data.schema().component_columns()}

    def frames(self, entity: str, index: str) -> list[int]:
        table = self._data.view(index=index, contents=f"/{entity}").select().read_all()
        return [int(n) for n in table.column(index).to_pylist()]

    def rows(self, entity: str, component: str, index: str | None) -> list[Any]:
        view = self._data.view(index=index or "frame", contents=f"/{entity}")
        table = (view.select() if index else view.select_static()).read_all()
        return list(table.column(f"/{entity}:{component}").to_pylist())


class _Chunks:
    """By the chunks of rerun 0.41, whose columns are called by archetype, and tell their component's type."""

    def __init__(self, path: Path) -> None:
        from rerun.chunk import RrdReader

        self._chunks = list(RrdReader(path).stream())

    def entities(self) -> set[str]:
        return {chunk.entity_path for chunk in self._chunks}

    def frames(self, entity: str, index: str) -> list[int]:
        parts = [chunk.to_record_batch().column(index).to_pylist() for chunk in self._of(entity, index)]
        return sorted({int(n) for part in parts for n in part})

    def rows(self, entity: str, component: str, index: str | None) -> list[Any]:
        found: list[tuple[int, Any]] = []
        for chunk in self._of(entity, index):
            batch = chunk.to_record_batch()
            at = batch.column(index).to_pylist() if index else [0] * batch.num_rows
            for field in batch.schema:
                kind = (field.metadata or {}).get(b"rerun:component_type", b"")
                if kind == f"rerun.components.{component}".encode():
                    found += zip(at, batch.column(field.name).to_pylist(), strict=True)
        values = [value for _, value in sorted(found, key=lambda one: one[0])]
        return values if index else values[-1:]  # what is static is replaced by what comes later

    def _of(self, entity: str, index: str | None) -> list[Any]:
        of_it = [chunk for chunk in self._chunks if chunk.entity_path == f"/{entity}"]
        return [one for one in of_it if (index in one.timeline_names if index else one.is_static)]
