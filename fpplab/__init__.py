"""fpplab: fringe projection profilometry on a bench, and on its digital twin.

The modules read in the order of a measurement: `plan` and `patterns` say what to
project, `devices` and `rig` what to project it with, `acquisition` and `session`
turn patterns into frames on disk, `phase` and `quality` frames into projector
coordinates, `characterisation` and `reconstruction` those into points, and
`comparison` points into an error against the true shape.
"""

from fpplab.core.version import __version__

__all__ = ["__version__"]
