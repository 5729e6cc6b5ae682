"""How much work each phase of a study is, from its settings: with it the display estimates the time that is left."""

from __future__ import annotations

from collections.abc import Collection

from hydro_agents.evaluation.protocol import tracking_cases
from hydro_agents.study.settings import StudySettings

# Relative costs: only their ratios matter, because the rate is measured while the work runs.
PERIOD = 1.5  # a control period of one axis
CALL = 200.0  # a control period of axes that are simulated together: Python around the kernel
TRAINING = {"ppo": 40.0}  # a control period in which a controller is trained, by kind
OTHER_TRAINING = 400.0  # off-policy algorithms update more often
BATCH = 1_500.0  # of the training of the leakage head
REPORT = 12e6

HEAD_PHASE = "train leakage head"


def work_of(study: StudySettings, done: Collection[str] = ()) -> dict[str, float]:
    """Relative work by the names of the phases on the console.

    Args:
        study: the study.
        done: finished phases of a study that is resumed (:class:`hydro_agents.study.phases.Phases`).
    """
    steps, work = study.task.steps, {}
    for name, entry in study.controllers.items():
        if entry.tune is not None and f"tune {name}" not in done:
            tune = entry.tune
            work[f"tune {name}"] = 2.0 * PERIOD * tune.evaluations * tune.cases * steps
        if entry.trainer is not None and f"train {name}" not in done:
            total = getattr(study.training_settings(name), "total_steps", 0)
            work[f"train {name}"] = TRAINING.get(entry.kind, OTHER_TRAINING) * total
    head = study.leakage_head
    if head is not None and HEAD_PHASE not in done:
        plan = head.plan(study.task, [study.make(name) for name in study.controllers if name not in study.trained])
        run = 1.25 * plan.longest
        for phase, episodes in (("data", head.episodes), ("validation", head.validation_episodes)):
            work[f"leakage head, {phase}"] = run * (CALL * len(plan.chunks(episodes)) + PERIOD * episodes)
        work["leakage head, training"] = BATCH * head.epochs * (head.windows * head.episodes / head.batch + 1.0)
    cases, _ = tracking_cases(study.evaluation)
    for name in study.controllers:
        work[f"tracking, {name}"] = steps * (CALL + PERIOD * len(cases))
        if head is not None:
            work[f"detection, {name}"] = steps * (CALL + 2.0 * PERIOD * study.evaluation.detection_episodes)
    return {**work, "report": REPORT}
