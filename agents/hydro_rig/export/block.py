"""The block around a controller that a machine runs: requests, signals and limits in; voltage, state and fault out.

It is written once, in array operations: Python runs it, and ``controller.py`` traces it for C, Structured Text and
ONNX. :class:`~hydro_rig.export.contract.State` lists the states; nothing but a new request of the user closes the loop.
"""

from typing import Any, NamedTuple

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.flow_model import FlowModel
from hydro_agents.controllers.own_loop import LOST_TIME, LOST_TRAVEL, STOPPING_TIME
from hydro_env.plant.analysis import speed_limits
from hydro_env.task.settings import settings_of
from hydro_env.types import ByName, Floats, Indices, Mask
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.export.contract import FaultCode, InternalReference, MeasuredSignals, State, block_inputs
from hydro_rig.export.tracing import named

COUNTED = 1_000_000  # lost samples; no counter runs over


class Sample(NamedTuple):
    """What a block knows of a sample before its controller answers."""

    begins: Any  # (), whether the controller begins here
    controls: Any  # (), whether the loop is closed
    state: Any
    observation: Any
    value: ByName  # signals by name, SI units
    complete: Any
    lost_signals: Any
    memory: ByName  # what is known of the next memory, by name


class BlockMemory(NamedTuple):
    """Memory from one sample to the next; zeros are those of a new block. Each () but path and parts of controller."""

    state: Indices
    fault_code: Indices
    command: Floats  # V, of the last call
    enabled: Mask  # inputs of the last call
    asks_control: Mask
    asks_manual: Mask
    asks_reset: Mask
    last: dict[str, Floats]  # last valid sample of each signal
    lost_samples: Indices  # successive ones
    rest: Floats  # V, that holds the load of the last complete sample
    seen: Mask  # whether there is a last position from which the speed follows
    velocity_estimate: Floats  # m/s
    error_integral: Floats | None  # m s; None: the controller does not read it
    follows: Mask  # the given reference is a motion; else a target of the block's own motion
    path: Floats  # (horizon + 1,), m, now and ahead: what is added to the reference, or the own motion
    path_speed: Floats  # m/s, at its end
    controller: Any


class Block:
    """A controller with the signals of a machine as inputs and the voltage of the valve as output."""

    def __init__(self, controller: Controller, signals: MeasuredSignals) -> None:
        self.controller, self.signals = controller, signals
        settings, plant = settings_of(signals.config)[0], signals.config.plant
        self._period, self._blend = signals.config.control_period, float(settings["velocity_blend"])
        self._integral_time = float(settings["integral_time"])
        self._integral_limit = float(settings["integral_limit"])
        self._model, self._speed_per_volt = FlowModel(plant), max(speed_limits(plant)) / FULL_VOLTAGE
        own = self._reference = InternalReference(signals)
        features = getattr(controller, "features", None)
        self.base: Any = features.base if features is not None else controller
        """The controller that a policy corrects, or the controller itself; ``None`` for a policy that acts alone."""
        self.corrects = features is not None and features.base is not None
        self.estimates: tuple[str, ...] = getattr(self.base, "estimate_names", ())
        self.inputs = block_inputs(signals.signals, own.max_speed, own.max_acceleration, self.corrects)

    # Before the controller: signals, state, reference ---------------------------------------------------------------

    def before(self, inputs: ByName, memory: BlockMemory) -> Sample:
        """Signals, state and observation of one sample; ``inputs`` by name, () each."""
        value, lost_signals = self._read(inputs, memory)
        complete = np.equal(lost_signals, 0)
        more = np.where(memory.lost_samples < COUNTED, 1, 0)
        lost_samples = np.where(complete, 0, memory.lost_samples + more)
        asks_manual = inputs["manual"]
        asks_control = inputs["control"] & ~asks_manual
        new = {
            "enabled": inputs["enable"],
            "asks_control": asks_control,
            "asks_manual": asks_manual,
            "asks_reset": inputs["reset"],
            "last": {signal.name: value[signal.name] for signal in self.signals.signals},
            "lost_samples": lost_samples,
        }
        resets = inputs["reset"] & ~memory.asks_reset
        was = {state: named(f"was_{state.name.lower()}", np.equal(memory.state, int(state))) for state in State}
        in_fault = was[State.FAULT] & ~resets
        free = inputs["enable"] & ~in_fault
        # Nothing moves without a new request: one that stood when the block was enabled must be repeated.
        new_manual = memory.enabled & ~memory.asks_manual
        manual = free & (asks_manual & (was[State.MANUAL] | new_manual))
        free = free & ~manual
        up = was[State.READY] | (was[State.CONTROLLING] | was[State.MANUAL])
        stays_away = was[State.HOLDING] & ~(resets & complete)
        too_long = up & self._lost_too_long(lost_samples, inputs, memory)
        holding = free & (stays_away | too_long)
        runs = free & (~holding & (complete | up))
        new_control = up & complete & ~memory.asks_control
        goes_on = was[State.CONTROLLING] | new_control
        may_control = runs & (asks_control & goes_on)
        begins = may_control & ~was[State.CONTROLLING]

        new["seen"] = complete | memory.seen & up
        self._add_speed(value, new, memory)
        self._reference.add(value, new, inputs, memory, begins)
        self._add_error(value, new, memory, begins)
        limit = inputs["error_limit"]
        beyond = (limit > 0.0) & (np.absolute(value["tracking_error"]) > limit)
        astray = may_control & ~begins & beyond
        controls = named("controls", may_control & ~astray)
        rest = self._model.voltage_at_rest(value["position"], value.get("pressure_a"), value.get("pressure_b"))
        new["rest"] = np.where(complete, rest, memory.rest)
        state = np.where(controls, int(State.CONTROLLING), np.where(runs, int(State.READY), int(State.OFF)))
        state = np.where(manual, int(State.MANUAL), np.where(holding, int(State.HOLDING), state))
        state = np.where(in_fault | astray, int(State.FAULT), state)
        value["previous_command"] = named("previous_command_sample", memory.command / FULL_VOLTAGE)
        observation = self.signals.observation(value)
        return Sample(begins, controls, state, observation, value, complete, lost_signals, new)

    def _read(self, inputs: ByName, memory: BlockMemory) -> tuple[ByName, Any]:
        """The signals by name, the last sample in place of a lost one; and a number with one bit per lost signal."""
        value = {}
        lost_signals: Any = 0
        for place, signal in enumerate(self.signals.signals):
            given, last, (lowest, highest) = inputs[signal.name], memory.last[signal.name], signal.beyond
            if signal.sensor:
                valid = inputs[f"valid_{signal.name}"]
                reading = np.where(valid, given, last)  # nothing is compared with a signal that is not valid
                inside = (lowest <= reading) & (reading <= highest)
                present = valid & inside
            else:
                present = (lowest <= given) & (given <= highest)
            present = named(f"{signal.name}_present", present)
            value[signal.name] = named(f"{signal.name}_sample", np.where(present, given, last))
            lost_signals = lost_signals + np.where(present, 0, 1 << place)
        return value, lost_signals

    def _lost_too_long(self, lost_samples: Any, inputs: ByName, memory: BlockMemory) -> Any:
        lost_travel = (lost_samples - 1) * (self._period * self._speed_per_volt) * np.absolute(memory.command)
        beyond_own = (lost_travel > LOST_TRAVEL) | (lost_samples * self._period > LOST_TIME)
        limit = inputs["lost_limit"]
        beyond_given = lost_samples > limit
        return (limit > 0) & beyond_given | (limit <= 0) & beyond_own

    def _add_speed(self, value: ByName, new: ByName, memory: BlockMemory) -> None:
        rate = (value["position"] - memory.last["position"]) / self._period
        speed = memory.velocity_estimate
        smoothed = np.where(memory.seen, speed + self._blend * (rate - speed), 0.0)
        value["velocity_estimate"] = new["velocity_estimate"] = named("velocity_estimate_sample", smoothed)

    def _add_error(self, value: ByName, new: ByName, memory: BlockMemory, begins: Any) -> None:
        error = value["reference"] - value["position"]
        value["tracking_error"] = named("tracking_error_sample", error)
        new["error_integral"] = integral = memory.error_integral
        if integral is not None:
            integral = integral + self._period * (error - integral / self._integral_time)
            integral = np.clip(integral, -self._integral_limit, self._integral_limit)
            goes_on = np.equal(memory.state, int(State.CONTROLLING)) & ~begins
            integral = named("error_integral_sample", np.where(goes_on, integral, 0.0))
            value["error_integral"] = new["error_integral"] = integral

    # The controller --------------------------------------------------------------------------------------------------

    def answer(self, observation: Any, inputs: ByName, memory: Any) -> tuple[ByName, Any]:
        """What the controller answers, by name, () each, and its new memory; ``None``: it begins."""
        controller = self.controller
        if hasattr(controller, "limited"):
            controller = controller.limited(_output_limit(inputs) / FULL_VOLTAGE)
        command, new = controller.predict(observation, memory)
        wanted = command.astype(np.float64)[0, 0]
        answer = {}
        if self.corrects:
            base_command = new.base_command.astype(np.float64)[0, 0]
            correction = wanted - base_command
            given = inputs["correction_limit"] / FULL_VOLTAGE
            limit = np.where(given >= 0.0, given, 0.0)
            limited = np.clip(correction, -limit, limit)
            corrected = base_command + limited
            wanted = np.where(np.absolute(correction) <= limit, wanted, corrected)
            answer["base_command"] = FULL_VOLTAGE * np.clip(base_command, -1.0, 1.0)
        if self.estimates:
            estimates = self.base.estimates(new.base if self.corrects else new)
            shown = dict(zip(self.estimates, estimates[0], strict=True))
            answer["estimated_leak"] = shown["leak"].astype(np.float64)
            answer["estimated_flow_gain"] = 1.0 + 0.1 * shown["flow_gain"].astype(np.float64)
            answer["estimated_offset"] = shown["offset"].astype(np.float64)
        wanted_voltage = FULL_VOLTAGE * np.clip(wanted, -1.0, 1.0)
        if self.corrects:
            answer["correction"] = wanted_voltage - answer["base_command"]
        return {"wanted": wanted_voltage, **answer}, new

    # After it: limits and faults -------------------------------------------------------------------------------------

    def after(
        self, sample: Sample, inputs: ByName, memory: BlockMemory, wanted: Any, refused: Any = False
    ) -> tuple[ByName, ByName]:
        """Outputs and the memory but that of the controller, by name.

        ``wanted``: V, of the controller if it controls; ``refused``: whether a gain is out of its range.
        """
        usable = np.absolute(wanted) <= FULL_VOLTAGE  # not for what is not a number
        failed = sample.controls & ~usable
        state = np.where(failed, int(State.FAULT), sample.state)
        is_now = {one: named(f"is_{one.name.lower()}", np.equal(state, int(one))) for one in State}
        by_hand = inputs["manual_command"]
        by_hand = np.where(np.absolute(by_hand) <= 1e3 * FULL_VOLTAGE, by_hand, 0.0)
        rests = is_now[State.READY] | is_now[State.HOLDING]
        target = np.where(is_now[State.MANUAL], by_hand, np.where(rests, sample.memory["rest"], 0.0))
        target = np.where(is_now[State.CONTROLLING], wanted, target)
        limit = _output_limit(inputs)
        target = named("limited", np.clip(target, -limit, limit))
        rate = inputs["output_rate"]
        largest_step = np.where(rate > 0.0, rate, FULL_VOLTAGE / STOPPING_TIME) * self._period
        change = target - memory.command
        stepped = memory.command + np.where(change > 0.0, largest_step, -largest_step)
        command = np.where(np.absolute(change) <= largest_step, target, stepped)
        reason = np.where(failed, int(FaultCode.NOT_A_NUMBER), int(FaultCode.FOLLOWING_ERROR))
        reason = np.where(np.equal(memory.state, int(State.FAULT)), memory.fault_code, reason)
        lost = is_now[State.HOLDING] | ~sample.complete
        warning = np.where(refused, int(FaultCode.REFUSED_GAIN), int(FaultCode.NONE))
        fault_code = np.where(lost, int(FaultCode.LOST_SIGNAL), warning)
        fault_code = np.where(is_now[State.FAULT], reason, fault_code)
        outputs = {
            "command": command,
            "state": state,
            "fault_code": fault_code,
            "lost_signals": sample.lost_signals,
            "internal_reference": sample.value["reference"],
        }
        new = {**sample.memory, "state": state, "fault_code": fault_code, "command": command}
        return outputs, new

    # In Python -------------------------------------------------------------------------------------------------------

    def empty(self) -> BlockMemory:
        """The memory of a new block: zeros."""
        zero, number, no = np.zeros(()), np.array(0), np.array(False)
        observation = np.zeros((1, len(self.signals.layout.names)), np.float32)
        observation[0] = [0.25 if "pressure" in name else 0.0 for name in self.signals.layout.names]
        _, memory = self.controller.predict(observation, None)
        last = {signal.name: zero for signal in self.signals.signals}
        integral = zero if "error_integral" in self.signals.used else None
        path = np.zeros(self.signals.horizon + 1)
        common = (number, number, zero, no, no, no, no, last, number, zero, no, zero)
        return BlockMemory(*common, integral, no, path, zero, memory)

    def __call__(
        self, inputs: ByName, memory: BlockMemory | None = None, refused: bool = False
    ) -> tuple[ByName, BlockMemory]:
        """Outputs of one sample by name, and the memory for the next; inputs that are missing have their defaults.

        ``refused``: whether a gain was out of its range.
        """
        given: ByName = {row.name: np.asarray(inputs.get(row.name, row.default), row.kind) for row in self.inputs}
        memory = memory if memory is not None else self.empty()
        with np.errstate(all="ignore"):
            sample = self.before(given, memory)
            answer, controller = dict.fromkeys(self.answers, 0.0), memory.controller
            if bool(sample.controls):
                before = None if bool(sample.begins) else memory.controller
                answer, controller = self.answer(sample.observation, given, before)
            wanted = answer.pop("wanted")
            outputs, new = self.after(sample, given, memory, wanted, refused)
        found = {name: np.asarray(value).item() for name, value in {**outputs, **answer}.items()}
        return found, BlockMemory(**new, controller=controller)

    @property
    def answers(self) -> tuple[str, ...]:
        """Names of what :meth:`answer` returns."""
        corrected = ("base_command", "correction") if self.corrects else ()
        estimated = ("estimated_leak", "estimated_flow_gain", "estimated_offset") if self.estimates else ()
        return ("wanted", *corrected, *estimated)


def _output_limit(inputs: ByName) -> Any:
    """Largest command, V, (); 0 for what is not a number."""
    given = inputs["output_limit"]
    return np.where(given >= 0.0, np.minimum(given, FULL_VOLTAGE), 0.0)
