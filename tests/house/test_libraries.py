"""Other people's libraries themselves, where they are installed; docs/clients.md lists what was tried by hand."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import yaml

from hydro_env import PlantParameters, ServoHydraulicVectorEnv, linearise
from hydro_rig.export.c_files import c_compiler, compiled
from hydro_rig.export.plant import plant_code

ID = "ServoHydraulic-v0"
ROOT = Path(__file__).parents[2]
ZOO = ROOT / "configs" / "agents" / "rl_zoo3_ppo.yaml"


def python_of_page(name, start):
    """The one block of a page that begins so."""
    page = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    (code,) = re.findall(rf"^```python\n({start}\b.*?)^```$", page, flags=re.MULTILINE | re.DOTALL)
    return code


def test_control_libraries_take_the_linearised_axis():
    plant = PlantParameters().replace(friction={"model": "none"})
    space = linearise(plant, position=0.02).state_space(outputs=("position", "velocity"))
    a, b, c, d = space.matrices
    at_rest = d - c @ np.linalg.solve(a, b)
    assert np.linalg.eigvals(a).real.max() < 0.0
    assert at_rest[1, 0] == pytest.approx(0.0, abs=1e-9)
    assert np.isfinite(at_rest).all()
    control = pytest.importorskip("control")
    system = control.ss(*space.matrices, **space.names)
    assert system.output_labels == ["position", "velocity"]
    np.testing.assert_allclose(control.dcgain(system), at_rest, rtol=1e-6, atol=1e-9)
    assert np.isfinite(control.lqr(system, np.diag([1e8] + [0.0] * (len(a) - 1)), [[1.0]])[0]).all()


def test_torchrl():
    envs = pytest.importorskip("torchrl.envs")
    env = envs.GymEnv(ID, frame_skip=2, info="flat", episode_duration=0.1)
    env.auto_register_info_dict()
    assert "leakage_flow_lpm" in env.rollout(5)["next"].keys()  # noqa: SIM118, not a mapping
    many = envs.GymWrapper(ServoHydraulicVectorEnv(2, info="flat", autoreset_mode="SameStep", episode_duration=0.1))
    assert tuple(many.rollout(50, break_when_any_done=False).shape) == (2, 50)
    processes = envs.GymEnv(f"hydro_env:{ID}", num_envs=2, info="flat", episode_duration=0.1)
    assert tuple(processes.rollout(50, break_when_any_done=False).shape) == (2, 50)
    processes.close()


@pytest.mark.slow  # starts processes of Ray
@pytest.mark.parametrize("runners", [0, 1])
def test_rllib(runners, capsys):
    """The code of docs/clients.md."""
    pytest.importorskip("ray.rllib.algorithms.ppo", exc_type=ImportError)
    code = python_of_page("clients", "from ray.rllib")
    exec(code.replace("num_env_runners=1", f"num_env_runners={runners}"), {"__name__": "__main__"})
    assert capsys.readouterr().out.splitlines()[-1] == "100.0"


def test_tau_ctrl():
    tau = pytest.importorskip("tau_ctrl")
    env = gym.make(ID, episode_duration=0.1)
    observation, _ = env.reset(seed=0)
    planner = tau.MPPI(
        env, horizon=3, n_samples=4, vector_env_fn=lambda count: gym.make_vec(ID, num_envs=count, episode_duration=0.1)
    )
    over = False
    while not over:
        observation, _, terminated, truncated, _ = env.step(planner.predict(observation)[0])
        over = terminated or truncated
    assert truncated


def test_the_plant_drives_a_joint_of_mujoco(tmp_path, monkeypatch):
    """The code of docs/export.md; without the seal's friction it is another axis."""
    pytest.importorskip("mujoco")
    if c_compiler() is None:
        pytest.skip("this machine has no C compiler")
    code = python_of_page("export", "import ctypes")
    (tmp_path / "plant.so").write_bytes(compiled(plant_code().files, ["-shared", "-fPIC"]))
    monkeypatch.chdir(tmp_path)
    space = {"__name__": "__main__"}
    exec(code, space)
    assert space["difference"] < 1e-3
    with pytest.raises(AssertionError):
        exec(code.replace(" - forces.friction_force", ""), space)
    assert space["difference"] > 1e-2


def test_the_settings_for_rl_zoo3_are_those_of_ppo():
    ppo = pytest.importorskip("stable_baselines3").PPO
    ((name, settings),) = yaml.safe_load(ZOO.read_text(encoding="utf-8")).items()
    assert name == ID
    own = {"n_envs", "n_timesteps", "normalize"}  # of rl-zoo3
    assert set(settings) - own <= set(inspect.signature(ppo.__init__).parameters)
    assert settings["n_envs"] * settings["n_steps"] % settings["batch_size"] == 0


def test_rl_zoo3_trains_with_them(tmp_path):
    pytest.importorskip("rl_zoo3")
    words = f"--algo ppo --env {ID} --gym-packages hydro_env -conf {ZOO} -n 512 --eval-freq -1 --seed 1"
    small = ["-params", "n_envs:2", "n_steps:128", "batch_size:128", "-f", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-m", "rl_zoo3.train", *words.split(), *small], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    folder = tmp_path / "ppo" / f"{ID}_1"
    assert (folder / f"{ID}.zip").is_file()
    assert re.search(r"gamma\n +- 0\.975\n", (folder / ID / "config.yml").read_text(encoding="utf-8"))
