"""The leak from a measured flow: of simulated moves, and of a real ram."""

import numpy as np
import pytest
from recorded import RAM, RAM_COLUMNS

from hydro_env.units import LITRE_PER_MINUTE
from hydro_rig.diagnosis.volume_balance import volume_leak
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.recording import Recording, read_recording


def moves(leak, area=9e-4, period=0.02, noise=0.0, relief=False):
    """Moves of 3 s in both directions, under changing loads; the leak in l/min at 100 bar."""
    generator = np.random.default_rng(0)
    samples = round(3.0 / period)
    speed = np.concatenate([np.full(samples, sign * size) for size in (0.02, 0.05, 0.08, 0.1) for sign in (1.0, -1.0)])
    load = np.repeat(generator.uniform(-80e5, 80e5, 8), samples)
    difference = load + 5e5 * np.sign(speed)
    flow = area * speed + leak * LITRE_PER_MINUTE / 100e5 * difference
    if relief:
        flow[samples // 2 : samples] += 5.0 * LITRE_PER_MINUTE
    position = np.append(0.0, np.cumsum(speed[:-1]) * period)
    flow += noise * generator.standard_normal(len(flow))
    absent = np.full_like(flow, np.nan)
    signals = np.array([position, 50e5 + 0.5 * difference, 50e5 - 0.5 * difference, absent, absent])
    return Recording("moves", period * np.arange(len(flow)), signals, {}, [], {"flow": flow})


@pytest.mark.parametrize("leak", [0.0, 0.2, 1.0])
def test_the_leak_of_simulated_moves_lies_in_its_interval(leak):
    found = volume_leak(moves(leak, noise=0.02 * LITRE_PER_MINUTE))
    assert found.low <= leak <= found.high
    assert found.high - found.low < 0.05
    assert found.area == pytest.approx(9e-4, rel=0.01)


def test_an_open_relief_valve_is_left_out():
    found = volume_leak(moves(0.2, noise=0.02 * LITRE_PER_MINUTE, relief=True))
    assert found.value == pytest.approx(0.2, abs=0.03)


def test_a_negative_leak_and_too_few_moves_have_no_answer():
    assert "negative leak" in volume_leak(moves(-0.5)).why
    few = volume_leak(moves(0.2).part(0, 450))
    assert "steady moves" in few.why
    assert np.isnan(few.value)


def test_a_real_ram_with_a_pump_has_the_leak_that_was_found_by_hand():
    found = volume_leak(read_recording(RAM, ColumnMap.model_validate(RAM_COLUMNS)))
    assert 0.18 <= found.value <= 0.23  # l/min at 100 bar, by hand
    assert 0.14 < found.low < found.value < found.high < 0.26
    assert found.area == pytest.approx(1.40 * 0.0254**2, rel=0.01)
