"""Results against assumed parameters, and the friction that hides the trend of Fig. 13."""

import math

import numpy as np
import pandas as pd
import pytest

from hydro_env import PlantParameters, resistance_from_flow
from paper.loop import sensible_gain
from paper.rig import Rig
from paper.sensitivity import LEAK_NAME, RESULTS, Setting, assumed_parameters, other_values
from paper.settling import friction_scan_table, healthy_frequency


@pytest.fixture(scope="module")
def sensitivity(folder):
    return pd.read_csv(folder / "sensitivity.csv")


def test_every_assumed_parameter_is_ranked_for_every_result(sensitivity):
    names = {
        f"{group}.{field}"
        for group, settings in PlantParameters.model_fields.items()
        for field, details in settings.annotation.model_fields.items()
        if details.description.startswith("assumed")
    }
    assert len(names) >= 29
    assert set(sensitivity["result"]) == {result.name for result in RESULTS if not result.name.startswith("settling")}
    for _, part in sensitivity.groupby("result"):
        assert set(part["parameter"]) == names
        assert np.all(np.diff(part.sort_values("rank")["effect_percent"].dropna()) <= 0.0)
        assert part["effect_percent"].max() > 1.0


def test_effects_with_known_answers(sensitivity):
    rows = sensitivity.set_index(["result", "parameter"])
    amplifier, spool = (rows.loc[("bandwidth_hz", f"valve.{name}_gain")] for name in ("amplifier", "spool"))
    assert amplifier["at_low"] == pytest.approx(spool["at_low"], rel=1e-6)  # two factors of the loop gain
    assert amplifier["effect_percent"] > 1.0
    unused = ["friction.bristle_stiffness", "friction.bristle_damping", "supply.line_volume"]
    assert rows.loc[(slice(None), unused), "effect_percent"].max() < 1e-9
    settling = next(result for result in RESULTS if result.name == "settling_s")
    at = Setting(Rig(), healthy_frequency(Rig()), sensible_gain(Rig()))
    weak, normal, strong = (
        settling.compute(PlantParameters().replace(load={"viscous_damping": factor * 300.0}), at, 1.0)
        for factor in (0.8, 1.0, 1.2)
    )
    assert weak > normal > strong


def test_a_parameter_takes_a_lower_and_a_higher_value():
    base = PlantParameters()
    assumed = assumed_parameters(base)
    assert other_values(base, "load.viscous_damping", 300.0) == pytest.approx((240.0, 360.0))
    assert other_values(base, "lines.volume_a", 0.0) == (None, None)
    low, high = other_values(base, "load.external_force", 0.0)
    assert -low == high > 0.0
    seal = "leakage.external_resistance"
    assert math.isinf(assumed[seal])
    assert other_values(base, seal, assumed[seal]) == (resistance_from_flow(1.0), resistance_from_flow(0.1))
    assert LEAK_NAME in assumed


def test_friction_hides_the_trend_little_by_little():
    table = friction_scan_table(Rig(), (0.01, 1.0), (0.0, 0.02, 0.2, 1.0))
    scan = table.pivot(index="friction_share", columns="leak_lpm", values="settling_s")
    assert scan[0.01].is_monotonic_decreasing
    assert scan.loc[0.0, 0.01] > 3.0 * scan.loc[0.0, 1.0]
    assert scan.loc[1.0, 0.01] < 1.5 * scan.loc[1.0, 1.0]
