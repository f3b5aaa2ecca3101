"""True shapes: artefacts, standards, parts from files, and each as printed; importing it loads no trimesh."""

from fpplab.artefacts.base import Lengths
from fpplab.artefacts.catalogue import NAMES, artefact_types, make, save_stl, usual_sizes
from fpplab.artefacts.lengths import Corner, FeatureLength, FlatFace, SphereFace
from fpplab.artefacts.parts import load_part
from fpplab.artefacts.slicing import layer_count, slice_as_printed

__all__ = [
    "NAMES",
    "Corner",
    "FeatureLength",
    "FlatFace",
    "Lengths",
    "SphereFace",
    "artefact_types",
    "layer_count",
    "load_part",
    "make",
    "save_stl",
    "slice_as_printed",
    "usual_sizes",
]
