"""Types that every room uses."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""An array of floating-point numbers; the docstring of its function or field gives shape and unit."""
