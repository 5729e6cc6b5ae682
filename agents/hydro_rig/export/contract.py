"""What a block and its user agree on: inputs and outputs with units, states, fault codes."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

from hydro_agents.controllers.own_loop import LOST_TIME, LOST_TRAVEL, STOPPING_TIME
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.export.internal_reference import InternalReference
from hydro_rig.export.measured import MeasuredSignal


class State(IntEnum):
    """States of the block."""

    OFF = 0
    READY = 1
    CONTROLLING = 2
    MANUAL = 3
    HOLDING = 4
    FAULT = 5


class FaultCode(IntEnum):
    """Why the block holds or is in fault; the last one is a warning."""

    NONE = 0
    LOST_SIGNAL = 1
    FOLLOWING_ERROR = 2
    NOT_A_NUMBER = 3
    REFUSED_GAIN = 4


LOST_RULE = (
    f"those in which the axis travels {1e3 * LOST_TRAVEL:g} mm at the present command, at least one, "
    f"and not more than {1e3 * LOST_TIME:g} ms"
)


class BlockInput(NamedTuple):
    """An input of the block beside the gains."""

    name: str
    unit: str
    kind: type
    default: Any
    meaning: str


OUTPUTS = {
    "command": ("V", "of the valve, within ±10 V; positive: extends"),
    "state": ("", ", ".join(f"{one.value} {one.name.lower()}" for one in State)),
    "fault_code": ("", ", ".join(f"{one.value} {one.name.lower().replace('_', ' ')}" for one in FaultCode)),
    "lost_signals": ("", "sum of 1, 2, 4 … for each lost signal, in the order of the inputs"),
    "internal_reference": ("m", "that the controller follows"),
    "base_command": ("V", "of the controller that the policy corrects"),
    "correction": ("V", "of the policy"),
    "estimated_leak": ("l/min", "past the piston seal at 100 bar"),
    "estimated_flow_gain": ("1", "of the valve, per data sheet"),
    "estimated_offset": ("%", "of full speed, that neither explains"),
}
"""Unit and meaning of each output that a block may have."""


def block_inputs(signals: Sequence[MeasuredSignal], own: InternalReference, corrects: bool) -> list[BlockInput]:
    """The inputs of a block beside its gains.

    ``corrects``: whether its controller is a policy that corrects another one.
    """
    rows = [
        BlockInput("enable", "", bool, False, "FALSE: off"),
        BlockInput("control", "", bool, False, "a change to TRUE closes the loop"),
        BlockInput("manual", "", bool, False, "a change to TRUE hands the valve to manual_command; before control"),
        BlockInput("reset", "", bool, False, "a change to TRUE leaves holding, if no signal is lost, and fault"),
    ]
    ahead = False
    for signal in signals:
        if signal.ahead and not ahead:
            text = "TRUE: the references are a motion, now and ahead; FALSE: reference is a target of the own motion"
            rows.append(BlockInput("follow", "", bool, False, f"{text}. Read when the loop closes"))
            ahead = True
        rows.append(BlockInput(signal.name, signal.unit, float, 0.0, signal.meaning))
        if signal.sensor:
            text = "its sensor measures: wire, module and bus in order, a number"
            rows.append(BlockInput(f"valid_{signal.name}", "", bool, False, text))
    if not ahead:
        text = "TRUE: reference is a motion; FALSE: a target of the own motion. Read when the loop closes"
        rows.append(BlockInput("follow", "", bool, False, text))
    rows += [
        BlockInput("manual_command", "V", float, 0.0, "in state manual, such as that of another controller"),
        BlockInput("output_limit", "V", float, FULL_VOLTAGE, "largest command in every state"),
        BlockInput("output_rate", "V/s", float, FULL_VOLTAGE / STOPPING_TIME, "largest change; 0: the usual one"),
        BlockInput("max_speed", "m/s", float, own.max_speed, "of the own motion; 0: the usual one"),
        BlockInput("max_acceleration", "m/s^2", float, own.max_acceleration, "of it; 0: the usual one"),
        BlockInput("error_limit", "m", float, 0.0, "following error beyond which it is in fault; 0: none"),
        BlockInput("lost_limit", "", int, 0, f"successive lost samples that are allowed; 0: {LOST_RULE}"),
    ]
    if corrects:
        text = "largest correction by the policy; 0: the controller that it corrects acts alone"
        rows.append(BlockInput("correction_limit", "V", float, 2.0 * FULL_VOLTAGE, text))
    return rows
