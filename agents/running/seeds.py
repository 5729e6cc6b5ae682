"""Which seeds belong to training, validation and test.

A seed fixes plant, reference and noise, so that the sets of all three are disjoint.
"""

from __future__ import annotations

TRAINING_SEEDS = range(0, 1_000_000)
VALIDATION_SEEDS = range(1_000_000, 2_000_000)
TEST_SEEDS = range(2_000_000, 3_000_000)
"""Nothing is chosen by results on these; only the evaluation uses them."""
