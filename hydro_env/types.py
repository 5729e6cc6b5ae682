"""Types that every room uses."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""An array of floating-point numbers; the docstring of its function or field gives shape and unit."""

Mask = NDArray[np.bool_]
"""An array of truth values."""

Indices = NDArray[np.int64]
"""An array of whole numbers."""
