"""The data card: what a data set holds, how and from what it was made, its splits, licence and limitations.

`card.json` is for programs, `README.md` has the same content for people. Everything in it follows from the
request, so the card also shows whether a folder holds the data set that is to be made, or another one.
"""

import json
import math
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from fpplab.core import config
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import read_bounded, write_text
from fpplab.core.strict_json import parse_json
from sim.dataset.shard import CHECKSUMS, FIELDS, FRAMES, SCENES, FieldSpec, array_file, shard_name

CARD, README, PLAN = "card.json", "README.md", "plan.yaml"
FORMAT = "fpplab dataset 1"  # value of the card's field `format`
MADE_WITH = ("fpplab", "numpy", "bpy", "embreex")  # packages whose versions the card lists

SPLITS = (*["train"] * 4, "validation", *["train"] * 4, "test")  # the split of sample k is entry k modulo ten

LIMITS = (
    "Labels are of the centre of a pixel; its frame is a mean over the whole pixel, so at edges of depth, of "
    "print and of shadow the two may see different things.",
    "True surfaces are meshes: a round pillar is a polygon of 64 corners, and its normals are those of its "
    "facets.",
    "The camera's focus, the exposure of its rows and vibration are as in the rig's world, and not drawn.",
    "Where the rig's world vibrates, labels are of the item at rest.",
    "Light is direct: none bounces between surfaces or enters them, unless the rig's world says so.",
    "Every sample is a scene of its own, so no scene is in two splits; but all splits have the same kinds of "
    "artefact, the same boards and the same two devices.",
    "Sensor noise is shot and read noise of independent pixels: no fixed pattern, no dead pixels.",
)
"""Limitations that the card lists."""


def split_of(index: int) -> str:
    return SPLITS[index % len(SPLITS)]


def dataset_fields(bits: int, dimensions: dict[str, int]) -> dict[str, FieldSpec]:
    """Fields of every sample; those of fringe sets only where the plan has such."""
    frames = "|u1" if bits <= 8 else "<u2"
    return {
        f.name: FieldSpec(**{**asdict(f), "dtype": frames}) if f.name == FRAMES else f
        for f in FIELDS
        if 0 not in f.extent(dimensions)
    }


def make_card(
    recipe: dict[str, Any], fields: dict[str, FieldSpec], dimensions: dict[str, int], licence: str
) -> dict[str, Any]:
    described = [{**asdict(f), "shape": list(f.extent(dimensions)), "axes": f.shape} for f in fields.values()]
    size = sum(np.dtype(f["dtype"]).itemsize * math.prod(f["shape"]) for f in described)
    samples = recipe["samples"]
    return {
        "format": FORMAT,
        "what": "Fringe projection captures of random scenes, simulated, with the truth of every pixel",
        "licence": licence,
        **recipe,
        "shards": math.ceil(samples / recipe["shard_size"]),
        "splits": {
            split: sum(split_of(k) == split for k in range(samples)) for split in dict.fromkeys(SPLITS)
        },
        "bytes_per_sample": size,
        "bytes": samples * size,
        "fields": described,
        "limits": list(LIMITS),
        "made_with": {name: version(name) for name in MADE_WITH},
    }


def prepare_folder(folder: Path, card: dict[str, Any]) -> None:
    """Create the folder with its card, or check that the existing one has the same card."""
    if (folder / CARD).exists():
        _check_same(folder, card)
    elif folder.exists() and not _is_empty(folder):
        raise ConfigError(f"{folder}: exists and is not a data set; name another output")
    else:
        write_text(folder / CARD, json.dumps(card, indent=1, ensure_ascii=False) + "\n")
    for name, text in ((README, _readme(card)), (PLAN, config.to_yaml(card["plan"]))):
        if not (folder / name).exists():  # a process may have been killed after writing the card
            write_text(folder / name, text)


def _is_empty(folder: Path) -> bool:
    """Check whether the folder has nothing but drafts of a process that was killed."""
    return folder.is_dir() and all(path.name.startswith(".") for path in folder.iterdir())


def _check_same(folder: Path, card: dict[str, Any]) -> None:
    """Refuse to continue a data set with another card: `ConfigError`."""
    existing = read_card(folder)
    for key, value in json.loads(json.dumps(card)).items():
        if (current := existing.get(key)) != value:
            shown = f" ({current}, now {value})" if isinstance(value, int | str) else ""
            raise ConfigError(
                f"{folder}: holds a data set begun with another '{key}'{shown}; name another output, or ask "
                f"for the same again, see {folder / CARD}"
            )


def read_card(folder: Path) -> dict[str, Any]:
    path = folder / CARD
    try:
        card = parse_json(read_bounded(path, 50_000_000))  # bytes: it holds a whole world
    except FileNotFoundError:
        raise DataError(f"{folder}: is not a data set (it has no {CARD})") from None
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read ({error}); make the data set again") from error
    if not isinstance(card, dict) or card.get("format") != FORMAT:
        raise DataError(f"{path}: is not the card of a '{FORMAT}'")
    return card


def _readme(card: dict[str, Any]) -> str:
    rows = [
        f"| `{f['name']}` | {f['source']} | {np.dtype(f['dtype'])} {tuple(f['shape'])} | {f['axes']} "
        f"| {f['unit']} | {f['meaning']} |"
        for f in card["fields"]
    ]
    splits = ", ".join(f"{name} {count}" for name, count in card["splits"].items())
    rule = ", ".join(f"{k} is {name}" for k, name in enumerate(SPLITS) if name != SPLITS[0])
    made = ", ".join(f"{name} {number}" for name, number in card["made_with"].items())
    size, total = card["bytes_per_sample"] / 1e6, card["bytes"] / 1e9
    first, depth = shard_name(0), array_file("depth")
    limits = [f"* {limit}" for limit in card["limits"]]
    return f"""# {card["what"]}

* {card["samples"]} samples of {size:.1f} MB, {total:.2f} GB, in shards of {card["shard_size"]}
* Licence: {card["licence"]}
* Splits: {splits}; of a sample's index the last digit {rule}, any other {SPLITS[0]}
* Made by `fpplab dataset` on the rig "{card["rig"]["name"]}", seed {card["seed"]}; with {made}
* `{PLAN}`: what was projected; the exposure is each sample's own. `{CARD}`: this page for programs, with the
  rig, its world and the ranges that scenes were drawn from.

Shard n holds the samples from n times {card["shard_size"]} on, along the first axis of every array:
`numpy.load("{first}/{depth}", mmap_mode="r")[0]` is the depth of sample 0, and
`{__package__}.Dataset(".")[0]` all of it. `{SCENES}` has one line for each sample: its split, what was
drawn, and the whole world. `{CHECKSUMS}` has the checksums.

N images, S fringe sets, h rows, w columns. `camera` is what was recorded, `measured` what fpplab makes of it,
`truth` what the simulation knows: depth and normals come from the shapes themselves, never from decoding.

| field | source | type and shape | axes | unit | meaning |
|---|---|---|---|---|---|
{chr(10).join(rows)}

Frames and pixels are those of OpenCV's camera: x right, y down, z forward; pixel (0, 0) is the centre of the
first. On a projector of W columns a set of s stripes along x has the phase 2π s (u + 0.5) / W at column u;
along y it is the same with rows.

## Limits

{chr(10).join(limits)}
"""
