"""Seeds of training, validation and test.

A seed fixes plant, reference and noise; disjoint ranges of seeds keep the three sets apart.
"""

from __future__ import annotations

TRAINING_SEEDS = range(0, 1_000_000)
VALIDATION_SEEDS = range(1_000_000, 2_000_000)
TEST_SEEDS = range(2_000_000, 3_000_000)
"""Only the evaluation uses these; no choice depends on their results."""

SEED_MARK = "#"
"""Separates the name of a controller from the number of its training seed, as in ``PPO#3``."""


def first_training_seed(number: int, count: int) -> int:
    """First of the ``count`` training seeds of training ``number``; different numbers get different seeds.

    After the last training seed, the first ones are reused.
    """
    return TRAINING_SEEDS.start + (number * count) % (len(TRAINING_SEEDS) - count)
