"""References: where they start, what they ask of the plant, how often each family occurs, and the user's own."""

import numpy as np
import pytest
from scipy import stats

from hydro_env import REFERENCE_FAMILIES, ServoHydraulicEnv, ServoHydraulicVectorEnv
from hydro_env.plant.analysis import reachable_range, speed_limits
from hydro_env.task.reference_signals import MOVING_FAMILIES

FAMILIES = REFERENCE_FAMILIES[:-1]
COUNT, PERIOD = 200, 5e-3
RANGE_SHARE, SPEED_SHARE, LARGEST, ACCELERATION = 0.6, 0.7, 0.10, 4.0


def drawn(family, count=COUNT, seed=0, **config):
    """References of one family (axis, sample) and the axes behind them."""
    envs = ServoHydraulicVectorEnv(count, start="actual", **config)
    envs.reset(seed=seed, options={"reference": family})
    return envs.axes.reference.copy(), envs.axes


def allowed_range(parameters):
    """The range that references promise: a share of what the supply can hold, and no more than ±100 mm."""
    low, high = reachable_range(parameters)
    if parameters.load.spring_stiffness == 0.0:
        return -LARGEST, LARGEST
    return max(-LARGEST, RANGE_SHARE * low), min(LARGEST, RANGE_SHARE * high)


def speed_ratio(row, parameters):
    """Largest speed of a reference over the share of what the plant can do at that place in that direction."""
    speed = np.diff(row) / PERIOD
    ratios = []
    for value, place in zip(speed, row[:-1], strict=True):
        limits = speed_limits(parameters, parameters.load.spring_stiffness * place)
        ratios.append(abs(value) / (limits.extending if value > 0 else limits.retracting))
    return max(ratios) / SPEED_SHARE


@pytest.mark.parametrize("family", FAMILIES)
def test_references_start_at_the_axis_and_stay_within_reach(family):
    rows, axes = drawn(family)
    np.testing.assert_array_equal(rows[:, 0], axes.column("position"))
    assert rows.shape == (COUNT, 401 + 8)  # two seconds, and the preview of 40 ms behind them
    assert np.isfinite(rows).all()
    for axis in range(COUNT):
        low, high = allowed_range(axes.parameters(axis))
        assert low - 1e-12 <= rows[axis].min() <= rows[axis].max() <= high + 1e-12
    assert (np.ptp(rows, axis=1) > (1e-3 if family in MOVING_FAMILIES else 1e-4)).all()  # every one asks for something
    assert len(np.unique(rows[:, 200])) == COUNT


@pytest.mark.parametrize("family", ["point_to_point", "ramp", "sine", "multi_sine", "start_stop", "pause"])
def test_references_ask_for_no_more_speed_than_their_share(family):
    rows, axes = drawn(family, count=20)
    ratios = [speed_ratio(rows[axis], axes.parameters(axis)) for axis in range(20)]
    assert max(ratios) < 1.0 + 1e-2  # the discrete speed stands for the middle of the sample
    assert max(ratios) > 0.5  # and they do use it


@pytest.mark.parametrize("family", ["point_to_point", "sine", "multi_sine", "pause"])
def test_smooth_references_keep_the_acceleration_limit(family):
    rows, _ = drawn(family)
    acceleration = np.abs(np.diff(rows, 2)).max(axis=1) / PERIOD**2
    assert acceleration.max() < ACCELERATION * (1 + 1e-3)
    assert acceleration.max() > 0.25 * ACCELERATION
    slow, _ = drawn(family, references={"acceleration_limit": 0.5})
    assert np.abs(np.diff(slow, 2)).max() / PERIOD**2 < 0.5 * (1 + 1e-3)


def test_the_axis_hardly_moves_at_a_pause_a_slow_run_and_small_steps():
    pause, creep, staircase = (drawn(family)[0] for family in ("pause", "creep", "staircase"))
    assert np.ptp(pause[:, : round(1.0 / PERIOD)], axis=1).max() == 0.0  # then about a second for the move
    speeds = np.abs(np.diff(creep)).max(axis=1) / PERIOD
    assert 2e-4 < speeds.min() < speeds.max() < 2e-3  # m/s
    for row in staircase:
        sizes = np.abs(np.diff(row))
        sizes = sizes[sizes > 0.0]
        np.testing.assert_allclose(sizes, sizes[0])
        assert 0.05e-3 <= sizes[0] <= 0.2e-3


def test_sines_have_the_configured_frequency():
    rows, axes = drawn("sine", references={"frequency_range": (1.5, 1.5)})
    time = PERIOD * np.arange(401)
    inner = 0
    for axis, row in enumerate(rows[:, :401]):
        # After the fade the row is a constant plus one sine of 1.5 Hz: three coefficients leave no residue.
        late = time > 1.0 / 3.0
        basis = np.column_stack([np.ones(401), np.sin(2 * np.pi * 1.5 * time), np.cos(2 * np.pi * 1.5 * time)])[late]
        coefficients, *_ = np.linalg.lstsq(basis, row[late], rcond=None)
        assert np.abs(basis @ coefficients - row[late]).max() < 1e-9
        start = axes.column("position")[axis]
        if abs(coefficients[2]) < 1e-9:  # about the start
            inner += 1
            assert coefficients[0] == pytest.approx(start, abs=1e-9)
        else:  # beside it, from the end of the range inwards
            assert coefficients[0] + coefficients[2] == pytest.approx(start, abs=1e-9)
    assert COUNT // 2 < inner < COUNT


@pytest.mark.parametrize(
    "weights",
    [None, {"step": 1.0, "ramp": 3.0, "sine": 0.0, "start_stop": 6.0}, {"user": 1.0, "step": 1.0}],
    ids=["default", "given", "user"],
)
def test_families_occur_with_their_weights(weights):
    references = {"weights": weights, "user": [0.01, 0.02]} if weights else {}
    _, info = ServoHydraulicVectorEnv(3000, references=references).reset(seed=5)
    shares = {name: weight for name, weight in (weights or dict.fromkeys(MOVING_FAMILIES, 1.0)).items() if weight}
    observed = [int((info["reference_family"] == name).sum()) for name in shares]
    assert sum(observed) == 3000
    expected = 3000 * np.array(list(shares.values())) / sum(shares.values())
    assert stats.chisquare(observed, expected).pvalue > 1e-3
    assert (info["reference"][info["reference_family"] == "user"] == 0.01).all()


@pytest.mark.parametrize("family", FAMILIES)
def test_preview_is_the_future_reference(family):
    """What the observation previews is what the reference then becomes."""
    env = ServoHydraulicEnv(episode_duration=0.5)
    observation, info = env.reset(seed=1, options={"reference": family})
    seen, references = [observation * env.observation_scale], [info["reference"]]
    for _ in range(100):
        observation, _, _, _, info = env.step(np.zeros(1, np.float32))
        seen.append(observation * env.observation_scale)
        references.append(info["reference"])
    for column, ahead in enumerate((1, 2, 4, 8), start=1):
        for k in range(101 - ahead):
            assert seen[k][column] == pytest.approx(references[k + ahead] - references[k], abs=2e-8)
    assert env.observation_names[1:5] == tuple(f"reference_preview_{ms}ms" for ms in (5, 10, 20, 40))
    for times in ([0.1], []):
        assert ServoHydraulicEnv(references={"preview_times": times}).observation_space.shape == (9 + len(times),)


@pytest.mark.parametrize("given", ["task", "option"])
def test_a_users_reference_is_followed_sample_by_sample_and_held_at_its_end(given):
    wanted = 0.02 * np.sin(np.arange(30) * 0.2) + 0.01
    of_task = {"references": {"user": wanted.tolist(), "weights": {"user": 1.0}}} if given == "task" else {}
    env = ServoHydraulicEnv(episode_duration=0.25, start="actual", **of_task)
    _, info = env.reset(seed=0, options={"reference": wanted} if given == "option" else None)
    assert (info["reference_family"], info["position"]) == ("user", wanted[0])
    heard = [info["reference"], *(env.step(np.zeros(1, np.float32))[-1]["reference"] for _ in range(50))]
    np.testing.assert_array_equal(heard, np.append(wanted, np.full(51 - 30, wanted[-1])))
