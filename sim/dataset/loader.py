"""Reads a data set sample by sample, with the indexing of PyTorch's map-style data sets."""

import operator
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from fpplab.core import config
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.journals import whole_lines
from fpplab.core.strict_json import parse_object
from fpplab.patterns.plan import Plan
from sim.dataset.card import PLAN, SPLITS, read_card, split_of
from sim.dataset.shard import SCENES, Arrays, array_file, check_shard, shard_name


class Dataset:
    """The samples of a folder that `fpplab dataset` has made, with `len()` and `[k]`.

    Of a data set that is still being made, the samples of complete shards. No file is kept open, so that it
    can
    be pickled and shared by the worker processes of a data loader.
    """

    def __init__(self, folder: Path | str, fields: Iterable[str] | None = None) -> None:
        self.folder = Path(folder)
        self.card = read_card(self.folder)
        available = [field["name"] for field in self.card["fields"]]
        self.fields = tuple(available if fields is None else fields)
        for name in self.fields:
            if name not in available:
                raise ConfigError(f"{self.folder}: has no field '{name}'; it has {', '.join(available)}")
        size = self.card["shard_size"]
        complete = {n for n in range(self.card["shards"]) if (self.folder / shard_name(n)).is_dir()}
        self.indices = [k for k in range(self.card["samples"]) if k // size in complete]

    def split(self, name: str) -> Self:
        if name not in SPLITS:
            raise ConfigError(
                f"{self.folder}: has no split '{name}'; it has {', '.join(dict.fromkeys(SPLITS))}"
            )
        part = type(self)(self.folder, self.fields)
        part.indices = [k for k in self.indices if split_of(k) == name]
        return part

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, k: int) -> Arrays:
        """Read sample `k` of the split: new arrays by field, see `card["fields"]`."""
        shard, row = self._shard_and_row(k)
        return {name: _read(shard / array_file(name), row) for name in self.fields}

    def scene(self, k: int) -> dict[str, Any]:
        """Read what was drawn for a sample."""
        shard, row = self._shard_and_row(k)
        try:
            return parse_object(whole_lines(shard / SCENES)[row])
        except (ValueError, IndexError) as error:
            raise DataError(f"{shard / SCENES}: cannot be read ({error})") from error

    @cached_property
    def plan(self) -> Plan:
        """What was projected; the exposure differs from sample to sample."""
        return config.load_document(self.folder / PLAN, Plan)

    def check(self) -> None:
        """Compare every file with its checksum."""
        for number in sorted({k // self.card["shard_size"] for k in self.indices}):
            check_shard(self.folder / shard_name(number))

    def _shard_and_row(self, k: int) -> tuple[Path, int]:
        index = self.indices[operator.index(k)]
        number, row = divmod(index, self.card["shard_size"])
        return self.folder / shard_name(number), row


def _read(path: Path, row: int) -> np.ndarray[Any, Any]:
    try:
        return np.array(np.load(path, mmap_mode="r")[row])
    except (OSError, ValueError, IndexError) as error:
        raise DataError(
            f"{path}: is missing or damaged ({error}); `Dataset.check` lists which files are"
        ) from error
