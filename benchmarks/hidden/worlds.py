"""Worlds of hidden benches: everything that data sheets state is a little different, drawn from a seed."""

from typing import Any

import numpy as np

from fpplab.core import config
from sim.world import World

BOARD, CARD = "board", "grey_card"
NOMINAL = "world_twin"
"""What the data sheets say of every hidden bench."""
SHAPES = ("pyramid", "pillars", "steps")
MOVED, PAINTED = "pyramid_moved", "pyramid_painted"
"""The pyramid in another pose, and as first but of another surface."""


def drawn_world(seed: int, poses: int, binning: int) -> World:
    """Draw a world around that of the data sheets."""
    random = np.random.default_rng([seed, 0])

    def near(value: float, share: float) -> float:
        return float(value * random.uniform(1 - share, 1 + share))

    def around(*values: float, by: float) -> list[float]:
        return [float(value + random.uniform(-by, by)) for value in values]

    data = _nominal()
    camera, projector = data["camera"], data["projector"]
    camera |= {
        "binning": binning,
        "focal_mm": near(35, 0.006),
        "centre_offset_px": around(0, 0, by=40),
        "distortion": [*around(-0.09, 0.14, by=0.02), *around(0, 0, by=7e-4), 0.0],
        "f_number": near(7.2, 0.1),
        "focus_mm": around(450, by=10)[0],
        "vignetting": around(4.2, by=0.5)[0],
    }
    camera["sensor"] |= {
        "full_well_e": near(14500, 0.06),
        "read_noise_e": near(3.0, 0.3),
        "quantum_efficiency": near(0.59, 0.04),
        "black_level": near(0.012, 0.2),
    }
    black = random.uniform(0.02, 0.07)
    projector |= {
        "throw_ratio": near(1.2, 0.008),
        "centre_px": [around(455, by=4)[0], around(1111, by=5)[0]],
        "distortion": [*around(-0.03, 0.05, by=0.01), *around(0, 0, by=4e-4), 0.0],
        "T_camera_projector": {
            "rotation_deg": around(-14, -18, 2, by=0.5),
            "translation_mm": around(150, 0, 0, by=1.5),
        },
        "blur": random.uniform(0.6, 0.8),
        "fill_factor": random.uniform(0.9, 0.95),
        "focus_mm": around(477, by=12)[0],
        "aperture_mm": near(8.5, 0.15),
        "response": {"a": 0.65, "b": 0.65 * black, "g": random.uniform(0.95, 1.9)},
        "leds": {"green": {"lumens": near(155, 0.06), "wavelength_nm": 525}},
    }
    place = {
        "rotation_deg": around(180, 0, 0, by=1.0),
        "translation_mm": around(0, 0, 460, by=1.5),
    }
    moved = {
        "rotation_deg": [around(180, by=12)[0], *around(0, 0, by=8)],
        "translation_mm": around(0, 0, 455, by=6),
    }
    items: dict[str, Any] = {
        BOARD: {
            "target": "target_paper.yaml",
            "reflectance": near(0.85, 0.05),
            "ink": near(0.055, 0.2),
            "poses": {"count": poses, "tilt_deg": 28, "distance_mm": 450, "range_mm": 24, "turn_deg": 10},
        },
        **{shape: {"artefact": shape, "pose": place} for shape in SHAPES},
        MOVED: {"artefact": SHAPES[0], "pose": moved},
        PAINTED: {"artefact": SHAPES[0], "pose": place, "material": "painted"},
        CARD: {
            "card_mm": [260, 200],
            "pose": {"rotation_deg": around(0, 0, 0, by=0.7), "translation_mm": around(0, 0, 450, by=2)},
        },
    }
    painted = {
        "kind": "glossy",
        "reflectance": random.uniform(0.2, 0.6),
        "gloss": random.uniform(0.005, 0.04),
        "gloss_roughness": random.uniform(0.3, 0.6),
    }
    data |= {
        "seed": seed,
        "items": items,
        "material": {"reflectance": near(0.88, 0.03)},
        "materials": {"painted": painted},
        "ambient": random.uniform(0.005, 0.03),
        "render": {"path": "auto", "subpixels": 2, "computed_subpixels": 4, "cache": False},
    }
    return config.validate(data, World, f"hidden bench {seed}")


def nominal_world(bench: World) -> World:
    """Give the twin's world before the matching: by the data sheets, with the parts where they stand.

    Where a part stands is part of the question, so the twin is told it; it is not of the card and the board.
    """
    data, known = _nominal(), bench.model_dump(mode="json")
    data["camera"]["binning"] = bench.camera.binning
    parts = {name: known["items"][name] | {"material": None} for name in (*SHAPES, MOVED, PAINTED)}
    data["items"] = {BOARD: data["items"][BOARD], CARD: data["items"][CARD], **parts}
    data["render"] = {"path": "auto", "subpixels": 2, "computed_subpixels": 4, "cache": False}
    return config.validate(data, World, "the nominal twin")


def _nominal() -> dict[str, Any]:
    path = config.find_config(NOMINAL, "world")
    data: dict[str, Any] = World.load(path).model_dump(mode="json")
    return data
