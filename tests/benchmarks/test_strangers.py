"""The decoders of others are called as their authors mean it: frames made by formula give the truth."""

import numpy as np

from benchmarks.strangers import others, with_fpplab
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording

SIZE = (912, 8)


def test_every_decoder_gives_the_coordinate() -> None:
    """The phase begins at the centre of the first pixel, as in SLStudio."""
    origins = {stripes: -np.pi * stripes / SIZE[0] for stripes in (1, 8, 64)}
    sets = [
        {"axis": "x", "stripes": s, "steps": 6, "phase_origin_rad": origin} for s, origin in origins.items()
    ]
    plan = Plan.model_validate({"fringes": tuple(sets)})
    u = np.broadcast_to(np.arange(30.0, 880.0), (8, 850))
    frames = []
    for stripes, origin in origins.items():
        phase = 2 * np.pi * stripes * (u + 0.5) / SIZE[0] + origin
        frames += [np.rint(100 + 90 * np.cos(phase - 2 * np.pi * n / 6)).astype(np.uint8) for n in range(6)]
    recording = Recording(frames, plan, SIZE)
    for name, decoder in {"fpplab": with_fpplab, **others()}.items():
        coordinate, valid = decoder(recording)
        assert valid.all(), name
        assert np.abs(coordinate - u).max() < 0.05, name
