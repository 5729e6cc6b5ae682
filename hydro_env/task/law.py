"""The law from which rigs are drawn; its defaults are what is built and sold."""

import math
from typing import Any, Literal

from pydantic import Field

from hydro_env.files import Group, whole_group
from hydro_env.units import Number, Range, Whole, interval, quantity

FIRST_SEEDS = {"training": 1_000_000_000, "validation": 2_000_000_000, "test": 3_000_000_000}  # first rig of each split

MOST_RIGS = 10_000

# ISO 6020 and 3320
_CYLINDERS: dict[int, tuple[int, ...]] = {
    25: (12, 14, 18),
    32: (14, 18, 22),
    40: (18, 22, 28),
    50: (22, 28, 36),
    63: (28, 36, 45),
    80: (36, 45, 56),
    100: (45, 56, 70),
    125: (56, 70, 90),
}


def _share(default: float) -> Any:
    return quantity(default, "1", "share of the rigs", 0.0, 1.0)


class StructureLaw(Group):
    """Which rigs of a law have parts that a nameplate does not tell: bending loads, waves in lines, sharp edges."""

    tip_share: Number = _share(0.0)  # with a load that bends: a second mass behind a spring
    tip_mass: Range = interval((0.2, 0.8), "1", 0.01, 0.99)  # of the load, behind the spring
    tip_frequency: Range = interval((2.0, 30.0), "Hz", 0.2, 1e3)  # of the second mass while the piston stands
    tip_damping: Range = interval((0.005, 0.05), "1", 1e-4, 1.0)  # damping ratio of that oscillation
    wave_share: Number = _share(0.0)  # with waves in lines of 1 to 6 m
    line_length: Range = interval((1.0, 6.0), "m", 0.1, 100.0)  # of each line with waves
    valve_sensor_share: Number = _share(0.5)  # with pressure sensors at the valve, among those with waves
    sharp_share: Number = _share(0.0)  # with sharp edges, with the lap that the null flow needs

    @property
    def any(self) -> bool:
        """Whether any rig has such a part."""
        return max(self.tip_share, self.wave_share, self.sharp_share) > 0.0


class RigLaw(Group):
    """From which rigs each episode of a task takes its own; intervals are log-uniform."""

    count: int = Field(64, ge=1, le=MOST_RIGS)  # rigs, drawn once; each episode takes one of them
    split: Literal["training", "validation", "test"] = "training"  # no two splits share a rig
    first: int = Field(0, ge=0, le=10**8)  # number of the first rig of the split
    sheet: bool = True  # the observation ends with the data sheet; false: the agent must find out
    # The observation contains the reference so many paces ahead; none: at the task's preview_times
    preview_paces: tuple[Number, ...] = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
    cylinders: dict[int, tuple[Whole, ...]] = _CYLINDERS  # mm; bores, and the rods of each
    stroke_per_bore: Range = interval((3.0, 15.0), "1", 0.5, 100.0)  # length over bore
    longest_stroke: Number = quantity(1.2, "m", "longer ones are cut", 0.05, 10.0)
    supplies: tuple[Number, ...] = (70.0, 100.0, 120.0, 160.0, 210.0, 250.0)  # bar
    # l/min at 70 bar; of the valves on sale
    rated_flows: tuple[Number, ...] = (5.0, 10.0, 20.0, 40.0, 60.0, 100.0, 150.0, 250.0)
    full_speed: Range = interval((0.1, 1.0), "m/s", 0.005, 10.0)  # for which the valve is chosen
    natural_frequency: Range = interval((10.0, 80.0), "Hz", 0.5, 1e3)  # of the load on the oil, unless too heavy
    bandwidth: Range = interval((30.0, 150.0), "Hz", 1.0, 1e3)  # at which the spool lags by 90 degrees
    position_noise: Range = interval((1e-5, 1e-4), "1", 1e-9, 0.1)  # of the stroke
    position_resolution: Range = interval((1e-6, 4e-5), "1", 1e-9, 0.1)  # of the stroke
    position_accuracy: Range = interval((1e-4, 1e-3), "1", 1e-9, 0.1)  # of the stroke
    pressure_ranges: tuple[Number, ...] = (100.0, 160.0, 250.0, 400.0)  # bar; of the sensors
    pressure_noise: Range = interval((2e-4, 2e-3), "1", 1e-9, 0.1)  # of the range
    pressure_accuracy: Range = interval((2.5e-3, 1e-2), "1", 1e-9, 0.1)  # of the range
    double_rod_share: Number = _share(0.15)  # with a rod on both sides
    overlap_share: Number = _share(0.3)  # with an overlapped spool
    overlap: Range = interval((0.01, 0.1), "1", 1e-6, 0.5)  # of full stroke
    null_flow_share: Number = _share(0.5)  # with a measured null flow, among those without overlap
    null_flow: Range = interval((0.002, 0.03), "1", 1e-6, 0.5)  # of the rated flow
    ratio_share: Number = _share(0.2)  # with a 2:1 spool, among cylinders that suit it
    weight_share: Number = _share(0.2)  # with a load that hangs on the rod
    line_share: Number = _share(0.3)  # with lines between valve and cylinder, half of them hoses
    line_length: Range = interval((0.5, 3.0), "m", 0.01, 100.0)  # of each
    structure: StructureLaw = StructureLaw()
    no_spool_sensor_share: Number = _share(0.3)  # with no spool sensor
    # ms; control periods, and how often each occurs
    periods: dict[float, Number] = {1.0: 0.1, 2.0: 0.2, 4.0: 0.2, 5.0: 0.2, 8.0: 0.15, 10.0: 0.15}
    latency: Range = interval((0.5, 5.0), "ms", 0.01, 20.0)  # at most one period

    @whole_group
    def _can_be_drawn(self) -> "RigLaw":
        for name in ("cylinders", "supplies", "rated_flows", "pressure_ranges", "periods"):
            if not getattr(self, name):
                raise ValueError(f"{name}: is empty; a law needs at least one to draw from")
        for name in ("supplies", "rated_flows", "pressure_ranges"):
            if wrong := [value for value in getattr(self, name) if not 0.0 < value < math.inf]:
                raise ValueError(f"{name}: {wrong[0]:g}: each must be positive")
        for bore, rods in self.cylinders.items():
            if not rods or not all(0 < rod < bore for rod in rods):
                raise ValueError(f"cylinders: {bore}: {list(rods)}: needs rods, each thinner than the bore")
        if list(self.preview_paces) != sorted({paces for paces in self.preview_paces if 0.0 < paces <= 20.0}):
            raise ValueError(f"preview_paces = {list(self.preview_paces)}: must rise, each within 0 (excluded) to 20")
        for period, share in self.periods.items():
            if not 0.5 <= period <= 20.0 or not 0.0 < share < math.inf:
                must = "each must be within 0.5 to 20 ms, with a positive share"
                raise ValueError(f"periods: {period:g}: {share:g}: {must}")
        if min(self.periods) < self.latency[0]:
            raise ValueError(f"latency: its low end of {self.latency[0]:g} ms exceeds a period")
        return self
