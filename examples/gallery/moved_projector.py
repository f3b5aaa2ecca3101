"""The projector was turned by a quarter of a degree after the calibration."""

from bench import show

show(
    moved={
        "projector": {
            "T_camera_projector": {"rotation_deg": [-13.8, -18.35, 2.2], "translation_mm": [150, 0, 0]}
        }
    },
    limit_um=300,
)
