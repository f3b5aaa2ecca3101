"""Square markers of OpenCV's dictionaries, which say which part of a board is seen."""

from collections.abc import Iterator
from typing import Literal

import cv2
import numpy as np

from fpplab.targets.drawing import InkBox

DictionaryName = Literal[
    "4x4_50", "4x4_100", "4x4_250", "4x4_1000", "5x5_50", "5x5_100", "5x5_250", "5x5_1000",
    "6x6_50", "6x6_100", "6x6_250", "6x6_1000",
]  # fmt: skip


def markers_in(name: DictionaryName) -> int:
    return int(name.split("_")[1])


def load_dictionary(name: DictionaryName) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name.upper()}"))


def draw_marker(
    dictionary: cv2.aruco.Dictionary, marker: int, left: float, top: float, side: float
) -> Iterator[InkBox]:
    modules = dictionary.markerSize + 2
    module = side / modules
    for row, column in np.argwhere(dictionary.generateImageMarker(marker, modules, borderBits=1) == 0):
        x, y = left + column * module, top + row * module
        yield InkBox(x, y, x + module, y + module)
