"""True shapes: artefacts, standards, parts from files, and each as printed; importing it loads no trimesh."""

from fpplab.artefacts.base import Artefact, Lengths
from fpplab.artefacts.catalogue import NAMES, STANDARDS, artefact_types, make, save_stl, usual_sizes
from fpplab.artefacts.lengths import Corner, FeatureLength, FlatFace, SphereFace
from fpplab.artefacts.parts import check_solid, load_part
from fpplab.artefacts.slicing import layer_count, slice_as_printed

__all__ = [
    "NAMES",
    "STANDARDS",
    "Artefact",
    "Corner",
    "FeatureLength",
    "FlatFace",
    "Lengths",
    "SphereFace",
    "artefact_types",
    "check_solid",
    "layer_count",
    "load_part",
    "make",
    "save_stl",
    "slice_as_printed",
    "usual_sizes",
]
