"""The leak from a measured flow: of simulated moves, and of a real ram."""

import math

import numpy as np
import pytest
from recorded import RAM, RAM_COLUMNS

from hydro_env import task_config
from hydro_env.units import LITRE_PER_MINUTE
from hydro_rig.diagnosis.verdict import Kind, Leak, Limits, Verdict
from hydro_rig.diagnosis.volume_balance import Balance, by_volume, volume_leak
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.recording import Recording, read_recording


def moves(leak, area=9e-4, period=0.02, noise=0.0, relief=False):
    """Moves of 3 s in both directions, under changing loads; the leak in l/min at 100 bar."""
    generator = np.random.default_rng(0)
    samples = round(3.0 / period)
    speed = np.concatenate([np.full(samples, sign * size) for size in (0.02, 0.05, 0.08, 0.1) for sign in (1.0, -1.0)])
    difference = np.repeat(generator.uniform(-80e5, 80e5, 8), samples) + 5e5 * np.sign(speed)
    flow = area * speed + leak * LITRE_PER_MINUTE / 100e5 * difference
    if relief:
        flow[samples // 2 : samples] += 5.0 * LITRE_PER_MINUTE
    position = np.append(0.0, np.cumsum(speed[:-1]) * period)
    flow += noise * generator.standard_normal(len(flow))
    absent = np.full_like(flow, np.nan)
    signals = np.array([position, 50e5 + 0.5 * difference, 50e5 - 0.5 * difference, absent, absent])
    return Recording("moves", period * np.arange(len(flow)), signals, {}, [], {"flow": flow})


def leak_of(recording, area=9e-4):
    """On a rig whose piston has this area on the bore side, m²."""
    cylinder = {"bore_diameter": math.sqrt(4.0 * area / math.pi), "rod_diameter": 0.01}
    return volume_leak(recording, task_config(None, plant={"cylinder": cylinder}))


@pytest.mark.parametrize("leak", [0.0, 0.2, 1.0])
def test_the_leak_of_simulated_moves_lies_in_its_interval(leak):
    found = leak_of(moves(leak, noise=0.02 * LITRE_PER_MINUTE)).leak
    assert found.low <= leak <= found.high
    assert found.high - found.low < 0.05


def test_an_open_relief_valve_is_left_out():
    found = leak_of(moves(0.2, noise=0.02 * LITRE_PER_MINUTE, relief=True))
    assert found.leak.value == pytest.approx(0.2, abs=0.03)


def test_a_negative_leak_and_too_few_moves_have_no_answer():
    assert "negative leak" in leak_of(moves(-0.5)).why
    few = leak_of(moves(0.2).part(0, 450))
    assert "steady moves" in few.why
    assert np.isnan(few.leak.value)


@pytest.mark.parametrize(("factor", "known"), [(1.0, True), (0.92, True), (1.08, True), (0.88, False), (1.12, False)])
def test_a_balance_belongs_to_a_piston(factor, known):
    found = leak_of(moves(0.01, noise=0.02 * LITRE_PER_MINUTE), factor * 9e-4)
    verdict = by_volume(Verdict(Kind.UNKNOWN, "no motion", None), found, Limits(0.03, 0.1))
    assert (verdict.kind is Kind.HEALTHY) == (not found.why) == known
    assert known or verdict.why.startswith("no motion; flow fits a piston of 9 cm²")


def test_another_verdict_stays():
    other = Verdict(Kind.OTHER, "worn edges", None)
    assert by_volume(other, Balance(Leak(0.01, 0.005, 0.015), 8, 0.01, ""), Limits(0.03, 0.1)) is other


def test_a_real_ram_with_a_pump_has_the_leak_that_was_found_by_hand():
    found = leak_of(read_recording(RAM, ColumnMap.model_validate(RAM_COLUMNS)), 1.40 * 0.0254**2).leak
    assert 0.18 <= found.value <= 0.23  # l/min at 100 bar, by hand
    assert 0.14 < found.low < found.value < found.high < 0.26
