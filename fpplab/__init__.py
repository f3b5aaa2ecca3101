"""fpplab: fringe projection profilometry on a bench, and on its digital twin.

With these names a researcher loads a session, decodes, reconstructs, compares and plots::

    from fpplab import Calibration, Session, compare, decode, load_mesh, reconstruct

    session = Session.open("scan")
    decoded = decode(session.recording())
    result = reconstruct(session, Calibration.load("calibration.yaml"))
    print(result.diagnosis.sentence)
    print(compare(result.cloud, load_mesh("part.stl"), align=True).surface_smcd_um)

The packages read in the order of a measurement: `patterns` says what to project, `devices` what to project it
with, `acquisition` and `sessions` turn patterns into frames on disk, `phase` frames into projector
coordinates, `characterisation` and `reconstruction` those into points, and `comparison` points into an error
against the true shape. `pipeline` has the steps, and `workflows` what each command does with them.
"""

from __future__ import annotations

from importlib import import_module

from fpplab.core.version import __version__

TYPE_CHECKING = False  # of `typing`, which takes longer to load than the program to hear its first signal
if TYPE_CHECKING:
    from typing import Any

    from fpplab.calibration.model import Calibration
    from fpplab.clouds import Cloud, load_cloud, load_mesh, save_cloud
    from fpplab.comparison import Comparison, compare
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.patterns.recording import Recording
    from fpplab.phase import Decoded, decode
    from fpplab.pipeline.characterising import characterise_sessions
    from fpplab.results.scan import ScanResult
    from fpplab.service.client import ServiceClient
    from fpplab.sessions.session import Session
    from fpplab.targets import Target
    from fpplab.workflows.instrument import Instrument
    from fpplab.workflows.reconstruct import reconstruct
    from fpplab.workflows.scan import scan

_PLACES = {
    "Calibration": "calibration.model",
    "Cloud": "clouds",
    "Comparison": "comparison",
    "Decoded": "phase",
    "Instrument": "workflows.instrument",
    "Plan": "patterns.plan",
    "Recording": "patterns.recording",
    "Rig": "devices.rig",
    "ScanResult": "results.scan",
    "ServiceClient": "service.client",
    "Session": "sessions.session",
    "Target": "targets",
    "characterise_sessions": "pipeline.characterising",
    "compare": "comparison",
    "decode": "phase",
    "load_cloud": "clouds",
    "load_mesh": "clouds",
    "reconstruct": "workflows.reconstruct",
    "save_cloud": "clouds",
    "scan": "workflows.scan",
}
"""The public names, and where each is defined; imported when first used, so that the command line stays
quick."""

__all__ = [
    "Calibration",
    "Cloud",
    "Comparison",
    "Decoded",
    "Instrument",
    "Plan",
    "Recording",
    "Rig",
    "ScanResult",
    "ServiceClient",
    "Session",
    "Target",
    "__version__",
    "characterise_sessions",
    "compare",
    "decode",
    "load_cloud",
    "load_mesh",
    "reconstruct",
    "save_cloud",
    "scan",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
