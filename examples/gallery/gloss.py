"""A lacquered part."""

from bench import show

show(
    {"material": {"kind": "glossy", "reflectance": 0.5, "gloss": 0.3, "gloss_roughness": 0.15}},
    item="pillars",
    limit_um=100,
)
