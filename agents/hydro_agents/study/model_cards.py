"""Model cards: what a file of weights is, how it was trained, and what it reached, in the layout of model hubs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import yaml
from jinja2 import Environment, StrictUndefined

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.head import LeakageHead
from hydro_agents.evaluation.comparison import Grid
from hydro_agents.evaluation.evaluate import Evaluation, ratio_table
from hydro_agents.evaluation.metrics import METRICS
from hydro_agents.learning.features import PolicyFeatures
from hydro_agents.running.statistics import Interval, share_interval
from hydro_agents.running.text import correction_name
from hydro_env import TaskConfig, __version__

ENVIRONMENT = "ServoHydraulic-v0"

_TEMPLATE = Path(__file__).parent / "model_card.md.j2"

Figure = tuple[str, Interval]


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
    called = f"{algorithm} alone" if corrects is None else correction_name(algorithm, corrects)
    features = getattr(controller, "features", None)
    return _card(
        title=f"{shipped if weights is None else name}: {called}, for a hydraulic servo axis",
        tags=["reinforcement-learning", "deep-reinforcement-learning", "hydraulics", ENVIRONMENT],
        kind="reinforcement-learning",
        metrics=_tracking(evaluation, name, against, corrects),
        training=training,
        values={
            "axis": _axis(features.config, features.for_any_axis) if isinstance(features, PolicyFeatures) else "",
            "against": against,
            "corrects": corrects,
            "command": command,
            "weights": weights,
            "shipped": shipped,
        },
    )


def head_card(
    head: LeakageHead,
    evaluation: Evaluation,
    command: str,
    weights: str | None = None,
    shipped: str = "leakage_head",
) -> str:
    """Card of a leakage head, see :func:`controller_card`."""
    metrics = []
    for _, row in evaluation.detection_rates.iterrows():
        kind = "false alarms" if (row["group"], row["value"]) == ("class", "healthy") else "leaks flagged"
        unit = "l/min" if row["group"] == "range" else "seal"
        share = Interval(row["flagged_share"], row["low"], row["high"])
        what = f"{kind} under {row['controller']}, {row['value']} {unit}"
        metrics.append((what, share))
    return _card(
        title="Leakage head of a hydraulic servo axis",
        tags=["tabular-classification", "fault-diagnosis", "hydraulics", ENVIRONMENT],
        kind="tabular-classification",
        metrics=metrics,
        training=head.settings.training,
        values={
            "head": head.settings,
            "axis": _axis(head.settings.task, head.for_any_axis),
            "command": command,
            "weights": weights,
            "shipped": shipped,
        },
    )


def _axis(config: TaskConfig, for_any: bool = False) -> str:
    cylinder, period = config.plant.cylinder, 1e3 * config.control_period
    sizes = f"bore {1e3 * cylinder.bore_diameter:.4g} mm, stroke {1e3 * cylinder.stroke:.4g} mm"
    any_rig = "serves any rig that measures its position and both pressures; the results are those on"
    return (
        f"It {any_rig if for_any else 'was trained for'} a cylinder of {sizes}, with a control period of {period:g} ms."
    )


def card_file(name: str) -> str:
    """Name of a card's file; a controller's name may hold what a file name cannot."""
    return re.sub(r"[^\w.-]+", "_", name).strip(".") + ".md"


def _tracking(evaluation: Evaluation, name: str, against: str, corrects: str | None) -> Iterator[Figure]:
    """Errors against the first and the corrected controller, and what they cost."""
    cases = evaluation.cases
    ratios = [evaluation.ratios[evaluation.ratios["controller"] == name]]
    if corrects not in (None, against) and corrects in evaluation.controllers:
        further = ratio_table(cases, [corrects, name])
        ratios.append(further[further["group"].isin(("all", "equal_weight"))])
    for _, row in pd.concat(ratios).iterrows():
        ratio = Interval(row["ratio"], row["low"], row["high"])
        yield f"mean error / {row['against']}'s, {_group(row)}", ratio
        if row["group"] in ("all", "equal_weight"):
            sensed = Interval(*(row[f"ratio_sensor{end}"] for end in ("", "_low", "_high")))
            yield f"mean error in the sensor's frame / {row['against']}'s, {_group(row)}", sensed
    own, grid = cases[cases["controller"] == name], Grid(cases)
    for metric in METRICS.values():
        if metric.cost and metric.ratio:
            yield f"{metric.word.lower()} / {against}'s, all", grid.ratio(name, against, metric.name)
    yield "share of runs that failed", share_interval(int(own["failed"].sum()), len(own))


def _group(row: pd.Series[Any]) -> str:
    group, value = str(row["group"]), row["value"]
    if group == "level":
        return f"leak of {float(value):g} l/min"
    return {"all": "all", "equal_weight": "every kind of reference weighs the same"}.get(group, f"reference {value}")


def _card(
    *,
    title: str,
    tags: list[str],
    kind: str,
    metrics: Iterable[Figure],
    training: Mapping[str, Any],
    values: Mapping[str, Any],
) -> str:
    """The card: a head that hubs read, and the text of the template; ``values`` are those of the template."""
    front = {
        "library_name": "hydro_env",  # it loads the weights, whichever library trained them
        "pipeline_tag": kind,
        "license": "mit",
        "tags": tags,
    }
    text = Environment(trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, undefined=StrictUndefined)
    return text.from_string(_TEMPLATE.read_text(encoding="utf-8")).render(
        {"head": None, "environment": ENVIRONMENT, "version": __version__, "title": title, **values},
        metrics=[(name, *(f"{number:.4g}" for number in found)) for name, found in metrics],
        front=yaml.safe_dump(front, sort_keys=False, allow_unicode=True),
        settings=yaml.safe_dump(dict(training), sort_keys=False, allow_unicode=True),
    )
