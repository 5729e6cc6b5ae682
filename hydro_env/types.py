"""Types that every room uses."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]  # each docstring gives shape and unit
Mask = NDArray[np.bool_]  # an array of truth values
Indices = NDArray[np.int64]  # an array of whole numbers
