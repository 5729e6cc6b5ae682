"""The ledger of seeds: who uses which.

A seed fixes plant, reference and noise. Training, validation and test have a set of seeds each, and every use of them
has a range of its own in one set: the ranges are disjoint, and no choice depends on a result of test seeds.
"""

from dataclasses import dataclass
from typing import Any

from hydro_env import ConfigurationError

TRAINING_SEEDS = range(1_000_000)
VALIDATION_SEEDS = range(1_000_000, 2_000_000)
TEST_SEEDS = range(2_000_000, 3_000_000)

SEEDS_PER_FAMILY = 10_000  # seeds of each family of references, in ranges that hold plants by family


@dataclass(frozen=True, order=True)
class SeedRange:
    """Seeds for one purpose."""

    first: int
    count: int
    purpose: str

    def take(self, count: int, skip: int = 0) -> range:
        """``count`` seeds after the first ``skip``.

        Raises:
            ConfigurationError: the range holds fewer.
        """
        if skip + count > self.count:
            raise ConfigurationError(f"{skip + count} seeds are needed, but there are {self.count} for {self.purpose}")
        return range(self.first + skip, self.first + skip + count)

    def of_family(self, family: Any, plant: Any) -> Any:
        """Seeds of the plants with these numbers, of the families with these numbers; integers or arrays of them."""
        return self.first + SEEDS_PER_FAMILY * family + plant

    def training(self, number: int, count: int) -> range:
        """The ``count`` seeds of training ``number``: different numbers get different seeds.

        After the last seed, the first ones are reused.

        Raises:
            ConfigurationError: the range holds fewer.
        """
        return self.take(count, (number * count) % max(self.count - count, 1))


# Training -------------------------------------------------------------------------------------------------------------
LEARNING = SeedRange(0, 500_000, "policies, gains and plans of leak tests")
HEAD_TRAINING = SeedRange(500_000, 490_000, "windows of the leakage head")
ACCURACY = SeedRange(990_001, 9_000, "the errors of the integrator")
RIGS = SeedRange(999_100, 600, "drawn rigs, for the gains of any rig")
SCALES = SeedRange(999_760, 240, "the scales of a policy's inputs and errors")

# Validation -----------------------------------------------------------------------------------------------------------
THRESHOLDS = SeedRange(1_000_000, 100_000, "the thresholds of detectors and the settings of searches")
CHOICES = SeedRange(1_100_000, 120_000, "choices among the trainings of a study")
BENCHMARK_TRAINING = SeedRange(1_220_000, 200_000, "training recordings of the benchmark of leaking axes")
BENCHMARK_VALIDATION = SeedRange(1_420_000, 80_000, "validation recordings of that benchmark")
LEARNING_CURVE = SeedRange(1_600_000, 10_000, "the errors of policies while they learn")
CONTROLLER_VECTORS = SeedRange(1_700_000, 10_000, "the test vectors of exported controllers")
HEAD_VECTORS = SeedRange(1_710_000, 10_000, "the test vectors of an exported leakage head")
STANDSTILLS = SeedRange(1_720_000, 10_000, "the limit cycles of tuned gains")
TREND_CALIBRATION = SeedRange(1_730_000, 10_000, "the trend of axes over weeks")
LEAK_THRESHOLDS = SeedRange(1_800_000, 100_000, "the thresholds of the leakage protocol")
TRIAL_RUN = SeedRange(1_999_998, 2, "the trial run before a study")

# Test -----------------------------------------------------------------------------------------------------------------
EVALUATION = SeedRange(2_000_000, 120_000, "controllers, best found, leak bound and estimator on the same plants")
DIAGNOSIS = SeedRange(2_120_000, 10_000, "diagnosed recordings")
TRENDS = SeedRange(2_130_000, 10_000, "axes over weeks")
HIDDEN_RIGS = SeedRange(2_190_000, 6_000, "hidden rigs that are identified")
LEAK_TESTS = SeedRange(2_196_000, 4_000, "axes with worn valves under a leak test")
ROBUSTNESS = SeedRange(2_200_000, 120_000, "the robustness protocol")
BENCHMARK_TEST = SeedRange(2_320_000, 80_000, "test recordings of that benchmark, where it has no key")
LEAKAGE = SeedRange(2_400_000, 50_000, "the windows of the leakage protocol")
DETECTION = SeedRange(2_500_000, 200_000, "the episodes that a leakage head watches")
ANY_AXIS = SeedRange(2_450_000, 50_000, "plants of drawn test rigs")
EXPERIMENT_AXES = SeedRange(2_900_000, 50_000, "experiments, and the example of a study")

LEDGER = {name: each for name, each in vars().items() if isinstance(each, SeedRange)}

SEED_MARK = "#"  # separates the name of a controller from the number of its training seed, as in PPO#3
