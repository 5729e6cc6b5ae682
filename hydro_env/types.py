"""Types that every room uses; the docstring of a function or field gives shape and unit."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]  # in single precision, as observations and networks have them
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
Array = NDArray[Any]
Arrays = dict[str, Array]  # by name
ByName = dict[str, Any]  # values by name
