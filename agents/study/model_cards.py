"""Model cards: what a file of weights is, how it was trained, and what it reached, in the layout of model hubs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import pandas as pd
import yaml

from agents.controllers.base import Controller
from agents.evaluation.protocol import Evaluation
from agents.leakage.head import LeakageHead
from hydro_env import TaskConfig, __version__

ENVIRONMENT = "ServoHydraulic-v0"

LIMITS = """Everything is simulated; no real axis was measured. The results hold for the task below: its rig, the ranges
from which its plants are drawn, its control period and sensors. `hydro evaluate` scores the weights on another task."""


def controller_card(name: str, controller: Controller, evaluation: Evaluation, command: str) -> str | None:
    """Card of a trained controller, or ``None`` for one that has no training.

    Args:
        name: of the controller in the evaluation.
        controller: the controller.
        evaluation: its results.
        command: the command that made them.
    """
    training: Mapping[str, Any] = getattr(controller, "training", {})
    if not training:
        return None
    ratios = evaluation.ratios[evaluation.ratios["controller"] == name]
    against = str(ratios["against"].iloc[0]) if len(ratios) else ""
    metrics = [
        _metric(f"mean error / {against}'s, {_group(row)}", row["ratio"], row["low"], row["high"])
        for _, row in ratios.iterrows()
    ]
    algorithm = str(training.get("algorithm", "trained"))
    use = f"""```python
import gymnasium as gym
import hydro_env
from agents.learning.policy import PolicyController

policy = PolicyController.load("{name}/policy")
env = gym.make("{ENVIRONMENT}")
observation, _ = env.reset(seed=1)
action, memory = policy.predict(observation)
```"""
    return _card(
        title=f"{name}: {algorithm} on a hydraulic servo axis",
        tags=["reinforcement-learning", "deep-reinforcement-learning", "hydraulics", ENVIRONMENT],
        library="stable-baselines3" if "stable-baselines3" in algorithm else "hydro_env",
        task={"type": "reinforcement-learning", "name": "positioning of a hydraulic servo axis"},
        metrics=metrics,
        what=f"It positions the load of the environment `{ENVIRONMENT}` of `hydro_env` {__version__}, whose piston "
        f"seal leaks by an unknown amount. The error is the mean distance between position and reference; {against} "
        "has the same plants, references and noise.",
        use=use,
        training=training,
        config=getattr(getattr(controller, "features", None), "config", None),
        command=command,
    )


def head_card(head: LeakageHead, evaluation: Evaluation, command: str) -> str:
    """Card of a leakage head, see :func:`controller_card`."""
    metrics = []
    for _, row in evaluation.detection_rates.iterrows():
        kind = "false alarms" if (row["group"], row["value"]) == ("class", "healthy") else "leaks flagged"
        unit = "l/min" if row["group"] == "range" else "seal"
        what = f"{kind} under {row['controller']}, {row['value']} {unit}"
        metrics.append(_metric(what, row["flagged_share"], row["low"], row["high"]))
    use = f"""```python
import gymnasium as gym
import hydro_env
from agents.leakage.head import LeakageHead

head = LeakageHead.load("leakage_head")
env = gym.make("{ENVIRONMENT}")
observation, _ = env.reset(seed=1)
estimate, memory = head.predict(observation)  # NaN until a whole window is known
```"""
    return _card(
        title="Leakage head of a hydraulic servo axis",
        tags=["tabular-classification", "fault-diagnosis", "hydraulics", ENVIRONMENT],
        library="hydro_env",
        task={"type": "tabular-classification", "name": "leak past the piston, from 2 s of measured signals"},
        metrics=metrics,
        what="It reads position, both pressures, spool position and command. It tells whether oil leaks past the "
        "piston, how much, which other fault there may be, and when it does not know. The shortest window has "
        f"{head.settings.window} samples. Sizes are in l/min at 100 bar.",
        use=use,
        training=head.settings.training,
        config=head.settings.task,
        command=command,
    )


def card_file(name: str) -> str:
    """Name of a card's file; a controller's name may hold what a file name cannot."""
    return re.sub(r"[^\w.-]+", "_", name).strip(".") + ".md"


def _group(row: pd.Series[Any]) -> str:
    group, value = str(row["group"]), row["value"]
    if group == "level":
        return f"leak of {float(value):g} l/min"
    return {"all": "all", "equal_weight": "every kind of reference weighs the same"}.get(group, f"reference {value}")


def _metric(name: str, value: float, low: float, high: float) -> dict[str, Any]:
    return {"name": name, "value": float(f"{value:.4g}"), "low": float(f"{low:.4g}"), "high": float(f"{high:.4g}")}


def _card(
    *,
    title: str,
    tags: list[str],
    library: str,
    task: dict[str, str],
    metrics: list[dict[str, Any]],
    what: str,
    use: str,
    training: Mapping[str, Any],
    config: TaskConfig | None,
    command: str,
) -> str:
    hub = [
        {"type": _type(one["name"]), "name": one["name"], "value": one["value"], "verified": False} for one in metrics
    ]
    front = {
        "library_name": library,
        "license": "mit",
        "tags": tags,
        "model-index": [
            {
                "name": title,
                "results": [{"task": task, "dataset": {"name": ENVIRONMENT, "type": ENVIRONMENT}, "metrics": hub}],
            }
        ],
    }
    rows = [f"| {one['name']} | {one['value']:g} | {one['low']:g} to {one['high']:g} |" for one in metrics]
    settings = yaml.safe_dump(dict(training), sort_keys=False, allow_unicode=True)
    sheet = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True) if config else ""
    task_part = f"\n## Task\n\n```yaml\n{sheet}```\n" if sheet else ""
    return f"""---
{yaml.safe_dump(front, sort_keys=False, allow_unicode=True)}---

# {title}

{what}

## Use

{use}

## Results

`{command}`

| figure | value | 95 % interval |
|---|---|---|
{chr(10).join(rows)}

## Limits

{LIMITS}

## Training

```yaml
{settings}```
{task_part}"""


def _type(name: str) -> str:
    return "_".join("".join(c if c.isalnum() else " " for c in name.lower()).split())
