"""``python -m hydro_env``: an axis as text; with arguments the command ``hydro``, where that is not on the path."""

import sys
from contextlib import suppress
from importlib import import_module

import gymnasium as gym

from hydro_env.env import ServoHydraulicEnv

WIDTH = 61  # columns of the cylinder
EVERY = 16  # control periods between two lines


def show_axis() -> None:
    """Print two seconds of an axis with a worn seal under a P controller, a line every 80 ms."""
    env = gym.make("ServoHydraulic-v0")
    axis = env.unwrapped
    assert isinstance(axis, ServoHydraulicEnv)
    observation, _ = env.reset(seed=1, options={"leakage_flow_lpm": 1.0, "reference": "point_to_point"})
    column = axis.observation_names.index("tracking_error")
    gain, half = 50.0 * axis.observation_scale[column], 0.5 * axis.config.plant.cylinder.stroke
    print("An axis under a P controller; its seal leaks 1 l/min at 100 bar. #: piston, +: where it should be")
    for step in range(axis.config.steps):
        observation, _, _, _, info = env.step([gain * observation[column]])
        if step % EVERY == 0:
            cells = ["."] * WIDTH
            for mark, place in (("+", info["reference"]), ("#", info["position"])):
                cells[min(max(round((place / half + 1.0) * 0.5 * (WIDTH - 1)), 0), WIDTH - 1)] = mark
            error = 1e3 * (info["reference"] - info["position"])
            print(
                f"{axis.config.control_period * (step + 1):4.2f} s |{''.join(cells)}| error {error:6.2f} mm", flush=True
            )
    print("python -m hydro_env --help lists the commands")
    env.close()


if __name__ == "__main__":
    sys.argv[0] = "hydro"
    if len(sys.argv) > 1:
        import_module("hydro_agents.commands.launcher").main()
    else:
        with suppress(BrokenPipeError):  # the reader has closed the pipe
            show_axis()
