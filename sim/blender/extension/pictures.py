"""Grey levels as an image of Blender."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

NAME = "fpplab picture"


def show_picture(shares: NDArray[np.float32], path: str) -> None:
    """Make an image, and save it."""
    # shares (height, width)
    rows, columns = shares.shape
    image = bpy.data.images.new(NAME, columns, rows, is_data=True)
    pixels = np.ones((rows, columns, 4), np.float32)
    pixels[..., :3] = shares[::-1, :, None]
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    if path:
        image.filepath_raw, image.file_format = path, "PNG"
        image.save()
    else:
        image.pack()
