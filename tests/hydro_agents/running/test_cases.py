"""Episodes of cases: the same as of single environments, whatever runs beside them, and what a failure leaves."""

import sys

import numpy as np
import pytest

from hydro_agents.running.cases import Cases, ControllerError, run_cases
from hydro_env import ServoHydraulicEnv, TaskConfig

CONFIG = TaskConfig(episode_duration=0.3)
LONG = TaskConfig(
    episode_duration=1.0,
    leakage={"schedule": "growth"},
    plant={"load": {"spring_stiffness": 0.0}},
    randomisation={},
    initial_position_range=(0.7, 0.9),
)
NAMES = ServoHydraulicEnv(CONFIG).observation_names
ERROR, POSITION = NAMES.index("tracking_error"), NAMES.index("position")
CASES = Cases(np.array([11, 12, 13, 14, 15]), np.array([0.01, 4.0, 0.3, 1.0, 0.1]), np.array(["step", "sine"] * 3)[:5])


class Proportional:
    """Commands in proportion to the error; its memory counts the steps."""

    def __init__(self, gain=3.0):
        self.gain = gain
        self.calls = []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.calls.append((state, episode_start.copy(), deterministic, len(observation)))
        return (self.gain * observation[:, [ERROR]]).astype(np.float32), 1 if state is None else state + 1


class Ram:
    """Opens the valve fully on the chosen rows of a batch, so that these axes meet the end stop; others hold."""

    def __init__(self, rows, after=np.nan):
        self.rows, self.after = rows, after

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        step = 0 if state is None else state
        command = np.zeros((len(observation), 1))
        command[self.rows] = 1.0
        return command, step + 1


def single_episode(config, seed, leak, family, gain=3.0):
    """Position, reference, command, reward and observation of one episode of the single environment."""
    env = ServoHydraulicEnv(config)
    observation, info = env.reset(seed=seed, options={"leakage_flow_lpm": leak, "reference": family})
    rows, over = [], False
    while not over:
        before = observation
        action = gain * observation[ERROR]
        observation, reward, terminated, truncated, info = env.step([action])
        rows.append((info["position"], info["reference"], np.clip(action, -1, 1), reward, *before))
        over = terminated or truncated
    return np.array(rows)


def test_each_case_is_the_episode_of_a_single_environment():
    run = run_cases(CONFIG, Proportional(), CASES, signal_columns=[POSITION, ERROR])
    steps = CONFIG.steps
    assert run.position.shape == run.reference.shape == run.command.shape == run.spool.shape == (5, steps)
    np.testing.assert_allclose(run.time, 0.005 * np.arange(1, steps + 1))
    assert run.signals.shape == (5, 2, steps)
    for array in (run.position, run.reference, run.command, run.spool, run.reward, run.signals):
        assert array.dtype == np.float32  # half the memory, and finer than any sensor
    assert run.failed_at.dtype == np.int64
    for case in range(5):
        leak, family = CASES.leakage_flow_lpm[case], str(CASES.families[case])
        rows = single_episode(CONFIG, int(CASES.seeds[case]), leak, family)
        for column, array in enumerate((run.position, run.reference, run.command, run.reward)):
            np.testing.assert_array_equal(array[case], rows[:, column].astype(np.float32))
        np.testing.assert_array_equal(run.signals[case], rows[:, [4 + POSITION, 4 + ERROR]].T.astype(np.float32))
        assert run.leakage_flow_lpm[case] == pytest.approx(leak)
    assert run.failed_at.tolist() == [-1] * 5
    assert np.abs(np.diff(run.spool, axis=1)).max() > 0.0


def test_chunks_do_not_change_results():
    whole = run_cases(CONFIG, Proportional(), CASES)
    parts = [run_cases(CONFIG, Proportional(), part) for part in CASES.chunks(2)]
    for name in ("position", "command", "leakage_flow_lpm"):
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name))
    assert parts[0].signals is None


def test_the_controller_gets_its_memory_back_and_hears_where_episodes_begin():
    controller = Proportional()
    run_cases(CONFIG, controller, CASES)
    states, starts, deterministic, _ = zip(*controller.calls, strict=True)
    assert states == (None, *range(1, CONFIG.steps))
    assert starts[0].tolist() == [True] * 5
    assert not np.any(starts[1:])
    assert set(deterministic) == {True}


@pytest.fixture(scope="module")
def failing():
    """Axes 0 and 2 of four are driven into the end stop; their episodes last long enough to see it."""
    cases = Cases(np.array([21, 22, 23, 24]), families=np.array(["sine"] * 4))
    return cases, run_cases(LONG, Ram([0, 2]), cases, signal_columns=[POSITION])


def test_a_failed_axis_keeps_its_last_values(failing):
    _, run = failing
    assert (run.failed_at >= 0).tolist() == [True, False, True, False]
    for case in (0, 2):
        last = run.failed_at[case]
        assert 5 < last < LONG.steps - 5
        for array in (run.position, run.command, run.spool):
            assert array[case, last] != 0.0
            assert np.all(array[case, last:] == array[case, last])
        assert np.all(run.signals[case, 0, last + 1 :] == run.signals[case, 0, last])
        assert run.signals[case, 0, last] != run.signals[case, 0, last - 1]
        assert run.reward[case, last] < -200.0  # the failure itself is paid
        assert np.all(run.reward[case, last + 1 :] == 0.0)
        assert np.all(run.command[case] == 1.0)
        assert np.ptp(run.reference[case, last:]) > 0.0  # its reference goes on


class Answers:
    """Gives a prepared answer in its third call."""

    def __init__(self, answer):
        self.answer, self.calls = answer, 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        if self.calls < 3:
            return np.zeros((len(observation), 1)), state
        return self.answer(observation) if callable(self.answer) else self.answer


@pytest.mark.parametrize(
    ("answer", "where"),
    [
        (lambda o: (np.where(np.arange(5) == 3, np.nan, 0.0)[:, None], None), "seed 14"),
        (lambda o: (np.where(np.arange(5) == 1, np.inf, 0.0)[:, None], None), "seed 12, reference sine, leak 4 l/min"),
        (lambda o: (np.zeros(5), None), "seed 11"),
        (lambda o: (np.zeros((5, 2)), None), "seed 11"),
        (lambda o: (None, None), "seed 11"),
        (lambda o: ("left", None), "seed 11"),
        (lambda o: np.zeros((5, 1)), "seed 11"),
        (lambda o: sys.exit(0), "SystemExit"),
        (lambda o: {}["gain"], "KeyError"),
    ],
)
def test_an_answer_that_is_no_command_is_named_with_its_case(answer, where):
    with pytest.raises(ControllerError, match=f"{where}|{where}.* at 0.010 s") as raised:
        run_cases(CONFIG, Answers(answer), CASES)
    assert "\n" not in str(raised.value)
    assert "at 0.010 s" in str(raised.value)
