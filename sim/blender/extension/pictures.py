"""Grey levels as an image of Blender."""

import bpy
import numpy as np
from numpy.typing import NDArray

NAME = "fpplab picture"


def make_image(relative_levels: NDArray[np.float32], save_to: str) -> None:
    # relative_levels (height, width)
    rows, columns = relative_levels.shape
    image = bpy.data.images.new(NAME, columns, rows, is_data=True)
    pixels = np.ones((rows, columns, 4), np.float32)
    pixels[..., :3] = relative_levels[::-1, :, None]
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    if save_to:
        image.filepath_raw, image.file_format = save_to, "PNG"
        image.save()
    else:
        image.pack()
