"""Experiments, limit cycles and the cost of a leak: against formulas and known loops; as parts of a protocol."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from joblib import parallel_config
from proportional import Proportional, Relay, exact_task
from published import TABLES, assert_published

from hydro_agents.controllers.registry import make_controller
from hydro_agents.controllers.sampled_loop import sampled_loop
from hydro_agents.evaluation.experiments import EXPERIMENTS, bandwidths, crossing
from hydro_agents.evaluation.leak_price import full_command_speed, leak_price, stall_force
from hydro_agents.evaluation.limit_cycles import (
    find_limit_cycle,
    standstill_metrics,
    standstill_task,
)
from hydro_agents.evaluation.participants import Participants
from hydro_agents.evaluation.robustness_protocol import EXPERIMENTS as PARTS
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.evaluation.runner import run
from hydro_agents.evaluation.sweeps import HiddenPreview, sine_fit
from hydro_agents.learning.opponents import shipped
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import TaskConfig, resistance_from_flow
from hydro_env.plant.analysis import full_pressure_forces, speed_limits
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.task.configuration import task_config

frequency, force_step, force_sine, hold = EXPERIMENTS.values()

# Frequency response --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("leak", "gain"), [(0.01, 60.0), (4.0, 100.0)])
def test_a_small_sweep_is_the_linearised_loop(leak, gain):
    task = exact_task(leakage={"law": "laminar"})
    frequencies = (1.0, 4.0, 12.0, 30.0)
    table = frequency(
        task, {"P": Proportional(gain, task)}, [leak], 1, frequencies=frequencies, amplitude=5e-6, place=0.02
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


# Stiffness -----------------------------------------------------------------------------------------------------------


def static_stiffness(task, leak, gain, place):
    plant = task.plant.replace(leakage={"internal_resistance": resistance_from_flow(leak)})
    return sampled_loop(plant, place, task.control_period, task.command_latency).static_stiffness(gain)


@pytest.mark.parametrize("leak", [1.0, 4.0])
def test_a_small_force_meets_the_static_stiffness_of_the_loop(leak):
    task, gain, force = exact_task(), 80.0, 2.0
    table = force_step(task, {"P": Proportional(gain, task)}, [leak], 1, force=force, place=0.02)
    stiffness = static_stiffness(task, leak, gain, 0.02)  # N/m
    assert table["static_mm_per_kn"].item() == pytest.approx(1e6 / stiffness, rel=0.02)
    assert table["peak_mm"].item() >= table["remaining_mm"].item()
    slow = force_sine(task, {"P": Proportional(gain, task)}, [leak], 1, frequencies=[0.05], force=force, place=0.02)
    assert slow["compliance_mm_per_kn"].item() == pytest.approx(1e6 / stiffness, rel=0.05)


def test_a_leak_makes_the_loop_soft_and_gain_makes_it_stiff():
    task = exact_task()
    controllers = {str(gain): Proportional(gain, task) for gain in (40.0, 80.0)}
    table = force_step(task, controllers, [0.3, 4.0], 1, force=2.0, place=0.02)
    soft = table.set_index(["controller", "leakage_flow_lpm"])["static_mm_per_kn"]
    assert soft["40.0", 4.0] > 3.0 * soft["40.0", 0.3]
    assert soft["40.0", 4.0] == pytest.approx(2.0 * soft["80.0", 4.0], rel=0.1)
    assert (table["recovery_s"] < 1.5).all()


def test_deviations_are_counted_from_the_rest_before_the_force():
    task = exact_task()
    table = force_step(task, {"P": Proportional(40.0, task)}, [1.0], 2, force=1e-9, place=0.02)
    assert (table["peak_mm"] < 1e-3).all()
    assert np.isfinite(table["recovery_s"]).all()


def test_forces_and_leaks_that_the_task_changes_by_itself_do_not_count():
    plain = exact_task()
    busy = exact_task(leakage={"schedule": "growth"}, disturbance={"kind": "mixed", "force_share": (0.3, 0.5)})
    tables = [
        force_step(task, {"P": Proportional(40.0, task)}, [1.0], 1, force=2.0, place=0.02) for task in (plain, busy)
    ]
    pd.testing.assert_frame_equal(*tables)


# Standstill under noise ----------------------------------------------------------------------------------------------


def test_a_relay_cycles_on_the_real_plant_and_a_soft_loop_does_not():
    task = TaskConfig()
    controllers = {"relay": Relay(0.05, task), "soft": Proportional(100.0, task)}
    table = hold(task, controllers, [0.01, 1.0], 3, VALIDATION_SEEDS.start, places=[0.3])
    cycles = table.groupby("controller")["limit_cycle"].mean()
    assert cycles["relay"] == 1.0
    assert cycles["soft"] == 0.0
    assert (table.loc[table["controller"] == "relay", "amplitude_um"] > 30.0).all()
    assert table.loc[table["controller"] == "soft", "frequency_hz"].isna().all()
    assert not table["failed"].any()


def test_the_pid_does_not_cycle_at_a_leak_of_1_l_min_although_noise_moves_it():
    task = TaskConfig()
    table = hold(task, {"PID": shipped("pid", task)}, [1.0], 4, VALIDATION_SEEDS.start, places=[0.3])
    assert not table["limit_cycle"].any()
    assert (table["unrest_um"] > table["amplitude_um"]).all()
    assert (table["valve_travel_per_s"] > 0.0).all()


def test_offsets_are_those_of_the_reading():
    """A controller with an integral holds its reading on the reference, whatever the bias of the sensor is."""
    task = TaskConfig()
    pid = HiddenPreview(shipped("pid", task), task)
    table = hold(task, {"PID": pid}, [0.3], 4, VALIDATION_SEEDS.start, places=[0.0])
    assert (table["offset_um"] < 10.0).all()  # biases reach 80 µm


# As parts of a protocol ----------------------------------------------------------------------------------------------


class Broken:
    """A controller that returns NaN."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((len(observation), 1), np.nan), None


def test_a_broken_controller_loses_its_own_rows_only(monkeypatch):
    for name, experiment in EXPERIMENTS.items():
        monkeypatch.setitem(EXPERIMENTS, name, partial(experiment, plants=1))
    protocol = RobustnessProtocol(parts=PARTS, conditions={"plain": {}})
    good = Proportional(100.0, protocol.task)
    results = run(protocol, Participants({"P#0": good, "P#1": good, "broken": Broken()}), jobs=1)
    assert {error.partition(":")[0] for error in results.errors} == {
        f"broken under {name}" for name in PARTS if name != "leak_price"
    }
    tables = {name: results.table(name) for name in TABLES["experiments"]}
    assert_published("experiments", tables)
    assert all(set(table["controller"]) == {"P"} for name, table in tables.items() if name != "leak_price")

    with parallel_config(backend="threading", n_jobs=2):
        alone = run(protocol, Participants({"P": good}))
    for name, table in tables.items():
        pd.testing.assert_frame_equal(alone.table(name), table, check_exact=True)


# Limit cycles --------------------------------------------------------------------------------------------------------

PERIOD = 0.005
TIME = PERIOD * np.arange(300)
FLOOR = 15e-6
WAVE = np.sin(2.0 * np.pi * 12.0 * TIME)


def test_a_lasting_sine_is_found_with_amplitude_and_frequency():
    noise = np.random.default_rng(0).normal(scale=5e-6, size=len(TIME))
    cycle = find_limit_cycle(0.03 + 50e-6 * WAVE + noise + 1e-4 * TIME, PERIOD, FLOOR)
    assert cycle.sustained
    assert cycle.amplitude == pytest.approx(50e-6, rel=0.05)
    assert cycle.frequency == pytest.approx(12.0, abs=0.4)


@pytest.mark.parametrize(
    "motion",
    [
        np.zeros(len(TIME)),
        10e-6 * WAVE,  # below the floor
        100e-6 * WAVE * np.exp(-4.0 * TIME),  # dying out
        200e-6 * TIME,  # drift
        100e-6 * np.sin(2.0 * np.pi * 0.5 * TIME),  # slower than three cycles
        np.random.default_rng(1).normal(scale=5e-6, size=len(TIME)),
    ],
)
def test_what_comes_to_rest_is_none(motion):
    assert not find_limit_cycle(motion, PERIOD, FLOOR).sustained


def test_the_task_of_a_standstill_is_the_task_without_noise():
    config = TaskConfig(disturbance={"kind": "step"}, leakage={"schedule": "growth"}, command_latency=0.004)
    still = standstill_task(config)
    assert still.sensors.position.noise == still.sensors.pressure_a.noise == 0.0
    assert still.sensors.position.resolution == config.sensors.position.resolution
    assert still.sensors.position.bias == config.sensors.position.bias
    assert (still.disturbance.kind, still.leakage.schedule) == ("none", "constant")
    assert (still.command_latency, still.randomisation) == (0.004, config.randomisation)
    assert still.references.user[0] == still.references.user[-1] == 0.0
    assert max(still.references.user) == config.references.step_range[0]


def test_a_relay_on_the_plant_oscillates_and_a_weak_loop_does_not():
    config = TaskConfig()
    first = VALIDATION_SEEDS.start
    cases = Cases(np.arange(first, first + 3), np.array([0.03, 1.0, 4.0]), None)
    still = standstill_task(config)
    weak = make_controller("pid", config, {"proportional": 10.0, "integral": 1.0})
    found = {}
    for name, controller in {"relay": Relay(0.3, config), "weak": weak}.items():
        found[name] = standstill_metrics(run_cases(still, controller, cases), still)
    assert found["relay"]["limit_cycle"].tolist() == [1.0] * 3
    assert np.all(found["relay"]["frequency_hz"] > 3.0)
    assert np.all(found["relay"]["amplitude_um"] > 100.0)
    assert found["weak"]["limit_cycle"].tolist() == [0.0] * 3
    assert np.isnan(found["weak"]["frequency_hz"]).all()
    assert np.all(found["weak"]["failed"] == 0.0)


# Cost of a leak ------------------------------------------------------------------------------------------------------


def without_a_leak():
    """The paper's rig without leak and underlap."""
    return TaskConfig().plant.replace(leakage={"internal_resistance": np.inf}, valve={"underlap": 0.0})


@pytest.mark.parametrize("force", [-2000.0, 0.0, 3000.0])
def test_a_tight_seal_gives_the_speed_of_the_flow_law(force):
    plant = without_a_leak()
    limits = speed_limits(plant, force)
    assert full_command_speed(plant, 1.0, force) == pytest.approx(limits.extending, rel=5e-3)
    assert -full_command_speed(plant, -1.0, force) == pytest.approx(limits.retracting, rel=5e-3)


def test_a_tight_seal_stalls_at_the_force_of_full_pressure():
    limits = full_pressure_forces(without_a_leak())
    assert stall_force(without_a_leak(), 1.0) == pytest.approx(limits.extending, rel=1e-3)
    assert stall_force(without_a_leak(), -1.0) == pytest.approx(limits.retracting, rel=1e-3)


def test_the_speed_lost_is_about_the_leak_over_the_area():
    """Against a load, v falls by less than the largest leak over the smaller area; helped by one, it rises."""
    leaking = without_a_leak().replace(leakage={"internal_resistance": resistance_from_flow(4.0)})
    lost, gained = (
        full_command_speed(without_a_leak(), 1.0, force) - full_command_speed(leaking, 1.0, force)
        for force in (3000.0, -3000.0)
    )
    assert gained < 0.0 < lost < 70e5 / resistance_from_flow(4.0) / plant_coefficients(leaking).area_b


@pytest.mark.parametrize("law", ["laminar", "orifice"])
def test_every_price_rises_with_the_leak(law):
    table = leak_price(task_config(None, leakage={"law": law}), [0.01, 1.0, 4.0, 8.0])
    assert (np.diff(table["holding_power_w"]) > 0.0).all()
    assert (np.diff(table["holding_command"]) > 0.0).all()
    for name in ("speed_out_mm_s", "speed_back_mm_s", "force_out_n", "force_back_n"):
        assert (np.diff(table[name]) < 0.0).all(), name


def test_a_place_that_a_leak_makes_impossible_has_no_price():
    row = leak_price(TaskConfig(), [20.0], place=0.097).iloc[0]
    assert np.isnan(row["holding_power_w"])
    assert row["speed_out_mm_s"] == 0.0
