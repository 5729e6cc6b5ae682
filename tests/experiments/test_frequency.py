"""The sine sweep: against the linearised sampled loop, and the frequencies read from it."""

import numpy as np
import pandas as pd
import pytest
from proportional import Proportional, exact_task

from hydro_agents.controllers.sampled_loop import sampled_loop
from hydro_agents.evaluation.frequency import bandwidths, crossing, frequency_response
from hydro_agents.evaluation.sweeps import HiddenPreview, sine_fit
from hydro_env import resistance_from_flow


@pytest.mark.parametrize(("leak", "gain"), [(0.01, 60.0), (4.0, 100.0)])
def test_a_small_sweep_is_the_linearised_loop(leak, gain):
    task = exact_task(leakage={"law": "laminar"})
    frequencies = (1.0, 4.0, 12.0, 30.0)
    table = frequency_response(
        task, {"P": Proportional(gain, task)}, [leak], 1, frequencies, amplitude=5e-6, place=0.02
    )
    plant = task.plant.replace(leakage={"internal_resistance": resistance_from_flow(leak)})
    loop = sampled_loop(plant, 0.02, task.control_period, task.command_latency)
    expected = loop.response(gain, np.array(frequencies))
    for preview in (True, False):  # which this controller does not use
        found = table[table["preview"] == preview]
        answer = found["gain"] * np.exp(1j * np.deg2rad(found["phase_deg"]))
        np.testing.assert_allclose(answer, expected, rtol=0.02)
    assert (table["rest"] < 0.02).all()


def test_a_sine_is_fitted_beside_offset_and_drift():
    time = 5e-3 * np.arange(400)
    rows = np.stack([3.0 + 0.2 * time + 0.5 * np.cos(2 * np.pi * 4.0 * time - 1.0), np.zeros(400)])
    amplitude, rest = sine_fit(rows, time, 4.0)
    assert amplitude[0] == pytest.approx(0.5 * np.exp(-1j), abs=1e-12)
    assert amplitude[1] == 0.0
    np.testing.assert_allclose(rest, 0.0, atol=1e-12)


def test_bandwidths_of_a_first_order_lag():
    """It is −3 dB (exactly 1/√2: −3.01 dB) at its corner and never reaches −90°; with a dead time it does."""
    corner, frequency = 10.0, np.geomspace(0.5, 60.0, 200)
    answer = 1.0 / (1.0 + 1j * frequency / corner)
    rows = []
    for controller, dead_time in (("lag", 0.0), ("late", 0.01)):
        phase = np.rad2deg(np.unwrap(np.angle(answer * np.exp(-2j * np.pi * frequency * dead_time))))
        labels = {"controller": controller, "preview": False, "leakage_flow_lpm": 0.01, "seed": 0}
        rows.append(pd.DataFrame({"frequency_hz": frequency, "gain": np.abs(answer), "phase_deg": phase, **labels}))
    table = bandwidths(pd.concat(rows)).set_index("controller")
    assert table.loc["lag", "minus_3_db_hz"] == pytest.approx(corner, rel=3e-3)
    assert table.loc["lag", "minus_90_deg_hz"] == np.inf
    late = table.loc["late", "minus_90_deg_hz"]
    assert np.rad2deg(np.arctan(late / corner)) + 360.0 * late * 0.01 == pytest.approx(90.0, abs=0.1)


def test_crossings():
    frequency = np.array([1.0, 10.0, 100.0])
    assert crossing(frequency, np.array([0.0, -2.0, -4.0]), -3.0) == pytest.approx(10.0**1.5)
    assert crossing(frequency, np.array([-5.0, 0.0, 0.0]), -3.0) == 1.0
    assert crossing(frequency, np.array([0.0, 0.0, 0.0]), -3.0) == np.inf


def test_a_hidden_preview_shows_the_present_reference():
    task, seen = exact_task(), []

    class Watcher:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            seen.append(observation)
            return np.zeros((len(observation), 1)), None

    given = np.ones((2, len(Proportional(1.0, task).layout.names)), dtype=np.float32)
    HiddenPreview(Watcher(), task).predict(given)
    names = Proportional(1.0, task).layout.names
    hidden = np.array([name.startswith("reference_preview") for name in names])
    np.testing.assert_array_equal(seen[0], np.tile(~hidden, (2, 1)))
    assert given.all()  # the observation itself is untouched
