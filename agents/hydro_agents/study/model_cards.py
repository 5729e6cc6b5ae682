"""Model cards: what a file of weights is, how it was trained, and what it reached, in the layout of model hubs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd
import yaml

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.head import LeakageHead
from hydro_agents.evaluation.comparison import Grid
from hydro_agents.evaluation.metrics import METRICS
from hydro_agents.evaluation.protocol import Evaluation
from hydro_agents.evaluation.tables import ratio_table
from hydro_agents.running.statistics import Interval, share_interval
from hydro_env import TaskConfig, __version__

ENVIRONMENT = "ServoHydraulic-v0"

LIMITS = """Everything is simulated; no real axis was measured. The results hold for the task of the weights (their JSON
holds it): its rig, the ranges from which its plants are drawn, its control period and sensors. `hydro evaluate` scores
the weights on another task."""

POLICY_USE = """import gymnasium as gym
import hydro_env  # registers the environment
from hydro_agents.learning.policy import PolicyController
{more}
policy = PolicyController.load({weights})
env = gym.make("{environment}", config=policy.features.config)  # the task of its training
observation, info = env.reset(seed=1)
memory, over = None, False
while not over:
    action, memory = policy.predict(observation, memory)
    observation, reward, terminated, truncated, info = env.step(action)
    over = terminated or truncated"""

HEAD_USE = """import math

import gymnasium as gym
import hydro_env  # registers the environment
from hydro_agents.detection.head import LeakageHead
{more}
head = LeakageHead.load({weights})
env = gym.make("{environment}", config=head.settings.task)  # the task of its training
observation, info = env.reset(seed=1, options={{"leakage_flow_lpm": 0.5}})
memory = None
for period in range(head.settings.window):
    estimate, memory = head.predict(observation, memory)  # NaN until a whole window is known
    observation, *_ = env.step([0.3 * math.sin(0.05 * period)])  # any controller may act
probability, flow_lpm, *_ = estimate  # the fields of LeakageEstimate
print(f"leak: probability {{probability:.2f}}, {{flow_lpm:.2f}} l/min at 100 bar")"""

Metric = dict[str, Any]


def controller_card(
    name: str,
    controller: Controller,
    evaluation: Evaluation,
    command: str,
    corrects: str | None = None,
    weights: str | None = None,
    shipped: str = "policy",
) -> str | None:
    """Card of a trained controller, or ``None`` for one that has no training.

    Args:
        name: of the controller in the evaluation.
        controller: the controller.
        evaluation: its results.
        command: the command that made them.
        corrects: name in the evaluation of the controller that it corrects.
        weights: path of the weights for the code on the card; default: those that ship.
        shipped: name of the shipped weights.
    """
    training: Mapping[str, Any] = getattr(controller, "training", {})
    if not training:
        return None
    against = evaluation.controllers[0]
    algorithm = str(training.get("algorithm", "trained"))
    correction = f" It corrects the command of another controller, {corrects}." if corrects else ""
    config = getattr(getattr(controller, "features", None), "config", None)
    made_for = f" {_axis(config)}" if config is not None else ""
    return _card(
        title=f"{shipped if weights is None else name}: {algorithm} on a hydraulic servo axis",
        tags=["reinforcement-learning", "deep-reinforcement-learning", "hydraulics", ENVIRONMENT],
        library="stable-baselines3" if "stable-baselines3" in algorithm else "hydro_env",
        task={"type": "reinforcement-learning", "name": "positioning of a hydraulic servo axis"},
        metrics=list(_tracking(evaluation, name, against, corrects)),
        what=f"It positions the load of the environment `{ENVIRONMENT}` of `hydro_env` {__version__}, whose piston "
        f"seal leaks by an unknown amount.{correction}{made_for} The error is the mean distance between position and "
        f"reference; {against} has the same plants, references and noise. Intervals: bootstrap over plants.",
        use=_use(POLICY_USE, weights, shipped),
        training=training,
        command=command,
    )


def head_card(head: LeakageHead, evaluation: Evaluation, command: str, weights: str | None = None) -> str:
    """Card of a leakage head, see :func:`controller_card`."""
    metrics = []
    first = evaluation.detection_rates["controller"].iloc[0]
    for _, row in evaluation.detection_rates.iterrows():
        kind = "false alarms" if (row["group"], row["value"]) == ("class", "healthy") else "leaks flagged"
        unit = "l/min" if row["group"] == "range" else "seal"
        share = Interval(row["flagged_share"], row["low"], row["high"])
        what = f"{kind} under {row['controller']}, {row['value']} {unit}"
        metrics.append(_metric(what, share, main=row["controller"] == first))
    return _card(
        title="Leakage head of a hydraulic servo axis",
        tags=["tabular-classification", "fault-diagnosis", "hydraulics", ENVIRONMENT],
        library="hydro_env",
        task={"type": "tabular-classification", "name": "leak past the piston, from 2 s of measured signals"},
        metrics=metrics,
        what="It reads position, both pressures, spool position and command. It tells whether oil leaks past the "
        "piston, how much, which other fault there may be, and when it does not know. The shortest window has "
        f"{head.settings.window} samples. {_axis(head.settings.task)} Sizes are in l/min at 100 bar. Results are "
        "shares of test episodes that are flagged, at the threshold of the weights; intervals: Wilson.",
        use=_use(HEAD_USE, weights, "leakage_head"),
        training=head.settings.training,
        command=command,
    )


def _axis(config: TaskConfig) -> str:
    """The axis that weights were made for, in one sentence."""
    cylinder, period = config.plant.cylinder, 1e3 * config.control_period
    sizes = f"bore {1e3 * cylinder.bore_diameter:.4g} mm, stroke {1e3 * cylinder.stroke:.4g} mm"
    return f"It was trained for a cylinder of {sizes}, with a control period of {period:g} ms."


def card_file(name: str) -> str:
    """Name of a card's file; a controller's name may hold what a file name cannot."""
    return re.sub(r"[^\w.-]+", "_", name).strip(".") + ".md"


def _tracking(evaluation: Evaluation, name: str, against: str, corrects: str | None) -> Iterator[Metric]:
    """Errors against the first and the corrected controller, and what they cost."""
    cases = evaluation.cases
    ratios = [evaluation.ratios[evaluation.ratios["controller"] == name]]
    if corrects not in (None, against) and corrects in evaluation.controllers:
        further = ratio_table(cases, [corrects, name])
        ratios.append(further[further["group"].isin(("all", "equal_weight"))])
    for _, row in pd.concat(ratios).iterrows():
        ratio = Interval(row["ratio"], row["low"], row["high"])
        main = row["group"] in ("all", "equal_weight")
        yield _metric(f"mean error / {row['against']}'s, {_group(row)}", ratio, main)
    own, grid = cases[cases["controller"] == name], Grid(cases)
    for metric in METRICS.values():
        if metric.cost and metric.ratio:
            yield _metric(f"{metric.word.lower()} / {against}'s, all", grid.ratio(name, against, metric.name))
    yield _metric("share of runs that failed", share_interval(int(own["failed"].sum()), len(own)))


def _group(row: pd.Series[Any]) -> str:
    group, value = str(row["group"]), row["value"]
    if group == "level":
        return f"leak of {float(value):g} l/min"
    return {"all": "all", "equal_weight": "every kind of reference weighs the same"}.get(group, f"reference {value}")


def _metric(name: str, found: Interval, main: bool = True) -> Metric:
    """A row of the results; hubs get the main ones."""
    return {"name": name, "main": main, **{key: float(f"{value:.4g}") for key, value in found._asdict().items()}}


def _use(code: str, weights: str | None, shipped: str) -> str:
    if weights is not None:
        return code.format(weights=f'"{weights}"', more="", environment=ENVIRONMENT)
    more = "from hydro_agents.running.folders import pretrained_folder\n"
    return code.format(weights=f'pretrained_folder() / "{shipped}"', more=more, environment=ENVIRONMENT)


def _card(
    *,
    title: str,
    tags: list[str],
    library: str,
    task: dict[str, str],
    metrics: list[Metric],
    what: str,
    use: str,
    training: Mapping[str, Any],
    command: str,
) -> str:
    hub = [
        {"type": _type(one["name"]), "name": one["name"], "value": one["value"], "verified": False}
        for one in metrics
        if one["main"]
    ]
    front = {
        "library_name": library,
        "pipeline_tag": task["type"],
        "license": "mit",
        "tags": tags,
        "metrics": [one["type"] for one in hub],
        "model-index": [
            {
                "name": title,
                "results": [{"task": task, "dataset": {"name": ENVIRONMENT, "type": ENVIRONMENT}, "metrics": hub}],
            }
        ],
    }
    rows = [f"| {one['name']} | {one['value']:g} | {one['low']:g} to {one['high']:g} |" for one in metrics]
    settings = yaml.safe_dump(dict(training), sort_keys=False, allow_unicode=True)
    return f"""---
{yaml.safe_dump(front, sort_keys=False, allow_unicode=True)}---

# {title}

{what}

## Use

```python
{use}
```

## Results

Test plants, which served no training and no choice; `{command}`:

| figure | value | 95 % interval |
|---|---|---|
{chr(10).join(rows)}

## Limits

{LIMITS}

## Training

```yaml
{settings}```
"""


def _type(name: str) -> str:
    return "_".join("".join(c if c.isalnum() else " " for c in name.lower().replace("'s", "")).split())
