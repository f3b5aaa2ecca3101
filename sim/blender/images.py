"""NumPy arrays as Blender's images."""

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray


def float_image(name: str, pixels: NDArray[np.float32]) -> Any:
    # pixels (rows, columns)
    rows, columns = pixels.shape[:2]
    image = bpy.data.images.new(name, columns, rows, float_buffer=True, is_data=True)
    filled = np.ones((rows, columns, 4), np.float32)
    filled[..., :3] = pixels[::-1] if pixels.ndim == 3 else pixels[::-1, :, None]
    image.pixels.foreach_set(filled.ravel())
    image.update()
    return image
