"""Measure the shipped weights on test plants, and write a model card beside each of them.

Run: python benchmarks/model_cards.py [policy policy_2ms policy_10ms policy_symmetric_eha policy_aalborg_svsdp_2017]

Each policy meets the PID and the flow linearisation of its own control period or rig, on the plants of `make study`.
`policy` and `policy_any_axis` bring the cards of the leakage heads as well. All take some minutes on two cores.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, NamedTuple

from hydro_agents.detection.monitor import HEAD_FILE, load_head
from hydro_agents.evaluation.evaluate import evaluate
from hydro_agents.learning.opponents import ANY_AXIS
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.folders import config_folder, pretrained_folder
from hydro_agents.study.entries import ControllerEntry
from hydro_agents.study.model_cards import controller_card, head_card
from hydro_agents.study.settings import StudySettings, default_study
from hydro_env.files import read_yaml, write_text

POLICY, CORRECTED = "PPO on flow linearisation", "Flow linearisation"
HEADS = {"policy": HEAD_FILE, "policy_any_axis": f"{HEAD_FILE}_{ANY_AXIS}"}


class Case(NamedTuple):
    """What a policy was trained for, and the gains of the controllers beside it (files in ``configs/agents``)."""

    made_for: dict[str, Any]
    pid: str = "pid"
    flow_linearising: str = "flow_linearising"


CASES = {
    "policy": Case({}),
    "policy_any_axis": Case({}),
    "policy_2ms": Case({"task": "period_2ms"}, pid="pid_2ms"),
    "policy_10ms": Case({"task": "period_10ms"}, pid="pid_10ms"),
    **{
        f"policy_{rig}": Case({"rig": rig}, f"pid_{rig}", f"flow_linearising_{rig}")
        for rig in ("symmetric_eha", "aalborg_svsdp_2017")
    },
}


def study_of(case: Case) -> StudySettings:
    """The study of `make study` for the task of a policy, with the gains that belong to it."""
    study = default_study(**case.made_for)
    gains = {"PID": ("pid", case.pid), CORRECTED: ("flow_linearising", case.flow_linearising)}
    entries = {
        name: ControllerEntry(kind=kind, settings=read_yaml(config_folder() / "agents" / f"{file}.yaml"))
        for name, (kind, file) in gains.items()
    }
    return study.model_copy(update={"controllers": entries | {POLICY: study.controllers[POLICY]}})


def write_cards(name: str, display: ProgressDisplay) -> list[Path]:
    """Measure one policy and write its card; for those of :data:`HEADS` that of a leakage head too."""
    case = CASES[name]
    study, command = study_of(case), f"python benchmarks/model_cards.py {name}"
    controllers = study.with_weights({POLICY: str(pretrained_folder() / name)})
    file_of_head = HEADS.get(name)
    head = load_head(pretrained_folder() / file_of_head, study.task) if file_of_head is not None else None
    found = evaluate(study.task, controllers, head, study.evaluation, display.update)
    card = controller_card(POLICY, controllers[POLICY], found, command, CORRECTED, shipped=name)
    assert card is not None
    cards = {name: card}
    if head is not None and file_of_head is not None:
        cards[file_of_head] = head_card(head, found, command, shipped=file_of_head)
    for file, text in cards.items():
        write_text(pretrained_folder() / f"{file}.md", text)
    return [pretrained_folder() / f"{file}.md" for file in cards]


def main(*names: str) -> int:
    """Write the cards; 2 for an unknown name."""
    for name in names:
        if name not in CASES:
            print(f"{name}: unknown; known: {', '.join(CASES)}", file=sys.stderr)
            return 2
    with ProgressDisplay() as display:
        for name in names or CASES:
            for file in write_cards(name, display):
                display.say(f"written: {file}")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
