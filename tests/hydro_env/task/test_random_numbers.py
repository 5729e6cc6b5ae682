"""Counted random numbers: their distributions, and that no source of randomness disturbs another."""

import numpy as np
import pytest
from scipy import stats

from hydro_env import ServoHydraulicVectorEnv
from hydro_env.task.random_numbers import (
    DISTURBANCE,
    INITIAL_STATE,
    LEAKAGE,
    NOISE,
    PLANT,
    REFERENCE,
    normal_pair,
    source_key,
    uniform,
)
from hydro_env.task.record import RECORD
from hydro_env.task.sensors import CHANNELS

COUNT = 5_000
ROOT = np.uint64(0x0123456789ABCDEF)


def key_of(root, episode, source):
    """The key as the type that compiled code uses (called from Python, it comes back as an integer of Python)."""
    return np.uint64(source_key(np.uint64(root), episode, source))


def along_one_key(function, *more, source=PLANT):
    key = key_of(ROOT, 0, source)
    return np.array([function(key, index, *more) for index in range(COUNT)])


@pytest.mark.parametrize("kind", ["numbers of a key", "episodes of an axis", "axes", "neighbouring keys"])
def test_uniform_numbers_are_uniform(kind):
    """Along every direction in which the environment counts."""
    rng = np.random.default_rng(0)
    if kind == "numbers of a key":
        values = along_one_key(uniform)
    elif kind == "episodes of an axis":
        values = np.array([uniform(key_of(ROOT, episode, LEAKAGE), 2) for episode in range(COUNT)])
    elif kind == "axes":
        roots = rng.integers(0, 2**64, COUNT, dtype=np.uint64)
        values = np.array([uniform(key_of(root, 0, REFERENCE), 0) for root in roots])
    else:
        values = np.array([uniform(np.uint64(key), 0) for key in range(COUNT)])
    assert 0.0 < values.min() <= values.max() < 1.0
    assert values.mean() == pytest.approx(0.5, abs=4 * np.sqrt(1 / 12 / COUNT))
    assert values.var() == pytest.approx(1 / 12, abs=4 * np.sqrt(1 / 180 / COUNT))
    assert stats.kstest(values, "uniform").pvalue > 1e-3
    assert abs(np.corrcoef(values[:-1], values[1:])[0, 1]) < 4 / np.sqrt(COUNT)
    assert len(np.unique(values)) == COUNT


def test_the_mixing_function_is_splitmix64():
    """Known answers of SplitMix64 seeded with 1234567 (Vigna's reference implementation)."""
    known = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431, 16408922859458223821]
    numbers = [uniform(np.uint64(1234567), index) for index in range(len(known))]
    assert numbers == [((bits >> 11) + 0.5) * 2.0**-53 for bits in known]


def test_normal_pairs_are_standard_normal_and_independent():
    pairs = along_one_key(normal_pair, source=NOISE)
    for column in pairs.T:
        assert stats.kstest(column, "norm").pvalue > 1e-3
        assert column.mean() == pytest.approx(0.0, abs=4 / np.sqrt(COUNT))
        assert column.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * COUNT))
    first, second = pairs.T
    for a, b in ((first, second), (first**2, second**2), (first[1:], first[:-1]), (first[1:], second[:-1])):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4.5 / np.sqrt(COUNT)
    # The angle of a pair is uniform: no direction is preferred.
    assert stats.kstest(np.arctan2(second, first) / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3


def test_sources_and_episodes_have_keys_of_their_own():
    sources = (PLANT, LEAKAGE, INITIAL_STATE, REFERENCE, NOISE, DISTURBANCE)
    keys = {
        key_of(root, episode, source)
        for root in (0, 1, 2**63, 2**64 - 1)
        for episode in range(50)
        for source in sources
    }
    assert len(keys) == 4 * 50 * len(sources)
    rows = np.array([[uniform(key_of(ROOT, e, source), 0) for source in sources] for e in range(2000)])
    assert np.abs(np.corrcoef(rows.T) - np.eye(len(sources))).max() < 4.5 / np.sqrt(2000)


def begin(options=None, count=40, **config):
    """What every source drew in one episode of many axes."""
    envs = ServoHydraulicVectorEnv(count, **config)
    first, _ = envs.reset(seed=77, options=options)
    axes = envs.axes
    column = {name: axes.column(name).copy() for name in RECORD.names}
    reference = axes.reference.copy()
    envs.step(np.zeros((count, 1), np.float32))
    return {
        "plant": axes.physical.copy(),
        "leak": column["leak_target_flow"],
        "leak start": column["leak_start_time"],
        "position": column["reference"],
        "family": column["reference_family"],
        "reference": reference,
        "bias": column["bias"],
        "noise": axes.column("measured")[:, CHANNELS.index("position")] - axes.column("position"),
        "force": column["force_amplitude"],
        "first observation": first,
    }


CHANGED = [
    ({"options": {"leakage_flow_lpm": 2.5}}, {"leak", "first observation"}),
    ({"leakage": {"healthy_share": 1.0, "schedule": "onset"}}, {"leak", "first observation"}),
    ({"options": {"reference": "sine"}}, {"family", "reference", "first observation"}),
    ({"references": {"weights": {"ramp": 1.0}}}, {"family", "reference", "first observation"}),
    ({"options": {"initial_position": 0.011}}, {"position", "reference", "noise", "first observation"}),
    ({"options": {"parameters": {"valve": {"damping_ratio": 0.7}}}}, {"plant", "first observation"}),
    ({"sensors": {"enabled": False}}, {"bias", "noise", "first observation"}),
    ({"disturbance": {"kind": "step"}}, {"force"}),
]


@pytest.mark.parametrize(("change", "may_change"), CHANGED)
def test_one_source_never_shifts_another(change, may_change):
    plain, changed = begin(), begin(**change)
    for name in set(plain) - may_change:
        if name == "noise":  # the plants differ a little after the step: quantisation may fall on the other side
            np.testing.assert_allclose(changed[name], plain[name], rtol=0, atol=1.01 * 0.4 / 26214, err_msg=name)
        else:
            np.testing.assert_array_equal(changed[name], plain[name], err_msg=name)
    assert any((changed[name] != plain[name]).any() for name in may_change)
