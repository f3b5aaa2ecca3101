"""The writing commands that are tried, on data as small as they allow."""

from pathlib import Path

import numpy as np
from PIL import Image as Pillow

from fpplab.core import config
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from tests.full_disk.trial import Writing

WIDTH, HEIGHT = 64, 48
PLAN = Plan(
    fringes=tuple(
        Sinusoid(axis="x", stripes=stripes, steps=4, projector_size=(WIDTH, HEIGHT)) for stripes in (1, 4)
    )
)


def pictures(folder: Path) -> None:
    """Fringes as a camera would see them that looks at the projector's pixels, and their plan."""
    (folder / "plan.yaml").write_text(config.dump(PLAN), encoding="utf-8")
    (folder / "images").mkdir()
    columns = (np.arange(WIDTH) + 0.5) / WIDTH
    noise = np.random.default_rng(1)
    for index, (number, step, _) in enumerate(PLAN.steps()):
        fringe = PLAN.fringes[number]
        turns = fringe.stripes * columns - step / fringe.images
        row = 120 + 90 * np.cos(2 * np.pi * turns)
        image = np.clip(row + noise.normal(0, 1, (HEIGHT, WIDTH)), 0, 255).astype(np.uint8)
        Pillow.fromarray(image).save(folder / "images" / f"f_{index:02d}.png")


def imported(folder: Path) -> None:
    """A session of these pictures."""
    from fpplab.sessions.image_selection import ImageSelection
    from fpplab.sessions.importing import import_images

    pictures(folder)
    import_images(ImageSelection((folder / "images",), "f_{index:02d}.png"), PLAN, folder / "session")


def nothing(folder: Path) -> None:
    """An empty disk."""


COMMANDS = (
    Writing(
        "import",
        pictures,
        lambda at: [
            "import",
            at / "images",
            "--plan",
            at / "plan.yaml",
            "--frames",
            "f_{index:02d}.png",
            "--out",
            at / "s",
        ],
    ),
    Writing("decode", imported, lambda at: ["decode", at / "session", "--out", at / "decoded.npz"]),
    Writing(
        "convert",
        nothing,
        lambda at: ["convert", "configs/calibration_matched.yaml", "--out", at / "some.yml"],
    ),
    Writing("artefact", nothing, lambda at: ["artefact", "pyramid", "--out", at / "part.stl"]),
)
