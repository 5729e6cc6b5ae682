"""The page about clusters, word for word: its array job with Slurm's variable (tests/site runs its program)."""

import os
import re
import stat
import subprocess

import pandas as pd
import pytest
from command_line import COMMAND, ROOT, environment

PAGE = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")
ARRAY, TABLES = re.findall(r"^```bash\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)
STUDY = """
task: {episode_duration: 0.4}
controllers:
  PID: {kind: pid}
  PPO:
    kind: ppo
    corrects: PID
    settings: {total_steps: 64, axes: 8, hidden_sizes: [4], validation_every: 0,
               steps_per_rollout: 8, minibatches: 1, epochs: 1}
leakage_head: {episodes: 100, validation_episodes: 100, epochs: 1, width: 4, batch: 64}
evaluation: {plants: 3, detection_episodes: 100, leak_levels: [0.01, 4.0], families: [step], bound_plants: 1}
"""


def without_times(file):
    table = pd.read_csv(file)
    return table[table["figure"] != "training, s"]


@pytest.mark.slow
def test_the_array_job_and_the_seeds_side_by_side_give_the_bits_of_one_after_another(tmp_path):
    (tmp_path / "quick.yaml").write_text(STUDY)
    own = tmp_path / "hydro"  # the command of this checkout, in the place of the installed one
    own.write_text(f'#!/bin/sh\nexec {" ".join(COMMAND)} "$@"\n')
    own.chmod(own.stat().st_mode | stat.S_IXUSR)
    path = os.pathsep.join([str(tmp_path), os.environ["PATH"]])

    def shell(script, **variables):
        script = script.replace("--config quick", "--config quick.yaml")
        variables = environment(PATH=path, **variables)
        done = subprocess.run(
            ["bash", "-ec", script], cwd=tmp_path, env=variables, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr

    first, last = map(int, re.search(r"--array=(\d+)-(\d+)", ARRAY).groups())
    assert f"--seeds {last - first + 1} " in TABLES
    for seed in (0, 2, 1):
        shell(ARRAY, SLURM_ARRAY_TASK_ID=str(seed))
    weights = tmp_path / "results" / "seeds" / "seed 1" / "controllers" / "PPO" / "policy.safetensors"
    written = weights.stat().st_mtime_ns
    shell(TABLES.replace("--seeds 8", "--seeds 3"))
    assert weights.stat().st_mtime_ns == written  # nothing was trained again
    line = "hydro study --config quick --seeds 3"
    shell(f"{line} --jobs 1 --output alone")
    shell(f"{line} --jobs 2 --output beside")
    assert (tmp_path / "beside" / "seed 2.log").stat().st_size > 0
    table = without_times(tmp_path / "results" / "seeds" / "tables" / "over_seeds.csv")
    for other in ("alone", "beside"):
        pd.testing.assert_frame_equal(
            without_times(tmp_path / other / "tables" / "over_seeds.csv"), table, check_exact=True
        )
        same = tmp_path / other / weights.relative_to(tmp_path / "results" / "seeds")
        assert same.read_bytes() == weights.read_bytes()
