"""A plant that cannot hold its start is drawn again: counted, reproducible, whatever the number of axes."""

import numpy as np
import pytest

from hydro_env import ServoHydraulicVectorEnv
from hydro_env.plant.kernel import MOST_STEPS_PER_PERIOD, STEPS
from hydro_env.task.kernel import MOST_DRAWS

HARD = {
    "a leak of 20 l/min": ({}, {"leakage_flow_lpm": 20.0}),
    "8 l/min through an orifice": ({"leakage": {"law": "orifice"}}, {"leakage_flow_lpm": 8.0}),
    "no underlap and an external leak": (
        {
            "plant": {"valve": {"underlap": 0.0}},
            "randomisation": {
                "leakage.external_resistance": {"log_uniform": [1e12, 1e13]},
                "load.mass": {"uniform": [40.0, 80.0]},
                "supply.pressure": {"uniform": [60e5, 100e5]},
            },
        },
        {},
    ),
    "a drawn leak of up to 20 l/min": ({"leakage": {"faulty_range": [10.0, 20.0]}}, {}),
}


@pytest.mark.parametrize("what", HARD)
def test_no_reset_is_refused_where_a_draw_can_be_held(what):
    config, options = HARD[what]
    envs = ServoHydraulicVectorEnv(1000, **config)
    for number in range(3):
        observation, info = envs.reset(seed=1000 * number, options=options)
        assert np.isfinite(observation).all()
        if "leakage_flow_lpm" in options:  # what the caller has fixed is not drawn again
            assert (info["leakage_flow_lpm"] == options["leakage_flow_lpm"]).all()
        assert (info["failure"] == "none").all()
    redraws = envs.axes.column("redraws")
    assert redraws.max() < MOST_DRAWS - 1
    if options:
        assert redraws.max() > 0  # the case is hard indeed


def test_a_period_that_takes_too_many_steps_ends_the_episode_with_a_name():
    """A rig that check-rig would refuse: friction so stiff that a period would take minutes."""
    stiff = {
        "plant": {
            "friction": {"transition_velocity": 1e-6, "coulomb_force": 1e6, "breakaway_force": 1e6},
            "load": {"mass": 0.01, "spring_stiffness": 0.0},
            "cylinder": {"piston_mass": 0.0},
        },
        "randomisation": {},
        "leakage": {"healthy_share": 1.0},
    }
    envs = ServoHydraulicVectorEnv(2, **stiff)
    untouched = ServoHydraulicVectorEnv(2, **stiff)
    for each in (envs, untouched):
        each.reset(seed=0)
    observation, reward, terminated, _, info = envs.step(np.ones((2, 1)))
    assert terminated.all()
    assert info["failure"].tolist() == ["integration budget exceeded"] * 2
    assert (envs.axes.peaks[:, STEPS] > MOST_STEPS_PER_PERIOD).all()
    assert (envs.axes.peaks[:, STEPS] <= MOST_STEPS_PER_PERIOD + 10).all()
    assert np.isfinite(observation).all()
    assert (reward <= -250.0).all()
    np.testing.assert_array_equal(untouched.step(np.ones((2, 1)))[0], observation)
