"""The project's controllers, leakage head and diagnosis on axes of Exudyn, a simulator that nobody here wrote.

    pip install "hydro_env[foreign]"
    python -m benchmarks.foreign_plants [--plants slide rigid_crane flexible_crane flexible_crane_told]
        [--controllers flow_linearising searched pid policy leak] [--leaks 0.01 1] [--output results/foreign_plants]

Rigs come from nameplates alone, as ``hydro new-rig`` makes them; what Exudyn simulates differs from them as usual
machines do. ``flexible_crane_told`` is the flexible crane whose nameplates name the frequency of its structure. The
rows are kept in the folder; a later call computes what is missing. ``leak``: the leakage head and ``hydro diagnose``
on a recording of flow linearisation.
"""

from __future__ import annotations

import argparse
import importlib
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import expm

from benchmarks.kept_rows import kept_rows
from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.controllers.own_loop import OwnLoop
from hydro_agents.controllers.registry import make_controller
from hydro_agents.detection.monitor import load_head
from hydro_agents.learning.loading import load_controller
from hydro_agents.learning.rig_gains import gain_sets, searched_gains
from hydro_agents.rigs.rig_file import answers_from, new_rig
from hydro_agents.running.text import markdown
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.files import write_text
from hydro_env.task.configuration import task_config
from hydro_env.task.reference_signals import MOVING_FAMILIES
from hydro_env.task.sensors import CHANNELS
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE
from hydro_rig.diagnosis.diagnose import diagnose
from hydro_rig.recordings.simulated import recording_csv

STEP = 2e-4  # s, of Exudyn's implicit integrator; it divides every period and latency here
SECONDS, SETTLING = 3.0, 0.5  # of each motion; before it the axis holds
RECORDED = 8.0  # s
SEED = 11
GRAVITY = 9.81
PIVOT_TO_ROD, PIVOT_TO_BASE = 0.5, 1.0  # m, from the boom's pivot along the boom, and straight down
BOOM, BOOM_MASS, PAYLOAD = 1.6, 40.0, 120.0  # m, kg, kg
HINGE = 0.8  # m, of the flexible boom; its outer part alone swings on it with the frequency and damping ratio below
HINGE_FREQUENCY, HINGE_DAMPING = 6.0, 0.01

A1 = {
    **{"bore": "40 mm", "rod": "28 mm", "stroke": "400 mm", "dead_volume": "30 cm3", "rated_flow": "10 l/min"},
    **{"bandwidth": "80 Hz", "supply_pressure": "70 bar", "mass": "60 kg", "spring": "89 N/mm"},
}
A2 = {
    **{"bore": "63 mm", "rod": "36 mm", "stroke": "400 mm", "rated_flow": "40 l/min", "bandwidth": "50 Hz"},
    **{"supply_pressure": "160 bar", "mass": "1700 kg", "external_force": "4.9 kN"},
}


class Machine(NamedTuple):
    """What Exudyn simulates; pressures are gauge pressures."""

    bore: float  # m
    rod: float  # m
    dead_volume: float  # m³, each side
    flow: float  # m³/s at 35 bar over one edge
    frequency: float  # Hz, of the spool
    damping_ratio: float  # of the spool
    supply: float  # Pa
    tank: float  # Pa
    viscous: float  # N s/m
    coulomb: float  # N
    breakaway: float  # N, beyond the Coulomb force
    stroke: float = 0.4  # m
    bulk_modulus: float = 1.1e9  # Pa


SLIDE = Machine(0.040, 0.028, 30e-6, 9.5 * LITRE_PER_MINUTE, 70.0, 0.7, 69e5, 2e5, 400.0, 200.0, 100.0)
CRANE = Machine(
    0.063, 0.036, 110e-6, 38.0 * LITRE_PER_MINUTE, 43.5, 0.7, 158e5, 2e5, 500.0, 160.0, 80.0
)  # low-friction seals


class Case(NamedTuple):
    """An axis of Exudyn, and what its rig's file is made from."""

    machine: Machine
    nameplates: Mapping[str, str]
    period: float  # s
    latency: float  # s
    kind: str  # of load
    told: Mapping[str, str] = {}  # nameplates beyond those of the other axes


PLANTS = {
    "slide": Case(SLIDE, A1, 0.005, 0.001, "slide"),
    "rigid_crane": Case(CRANE, A2, 0.002, 0.0006, "rigid"),
    "flexible_crane": Case(CRANE, A2, 0.002, 0.0006, "flexible"),
    "flexible_crane_told": Case(CRANE, A2, 0.002, 0.0006, "flexible", {"structure_frequency": "6 Hz"}),
}


LEAK = "leak"
CONTROLLERS = ("flow_linearising", "searched", "pid", "policy", LEAK)
LEAKS = (0.01, 1.0)  # l/min at 100 bar: a healthy seal, and a worn one


class Axis:
    """One axis in Exudyn, driven by :meth:`run`; positions from the middle of the stroke."""

    def __init__(self, case: Case, position: float, leak: float) -> None:
        self.exu = importlib.import_module("exudyn")
        self.items = importlib.import_module("exudyn.itemInterface")
        self.machine, self.mbs = case.machine, self.exu.SystemContainer().AddSystem()
        self.ground = self.mbs.AddObject(self.items.ObjectGround())
        point = self.mbs.AddNode(self.items.NodePointGround())
        self.still = self.mbs.AddMarker(self.items.MarkerNodeCoordinate(nodeNumber=point, coordinate=0))
        m = case.machine
        self.area_a, self.area_b = math.pi / 4 * m.bore**2, math.pi / 4 * (m.bore**2 - m.rod**2)
        self.shortest = math.hypot(PIVOT_TO_ROD, PIVOT_TO_BASE) - m.stroke / 2  # the boom is level at mid-stroke
        base, rod, force = self._slide(position) if case.kind == "slide" else self._boom(position, case.kind)
        low = 0.5 * (m.supply + m.tank) * self.area_a / (self.area_a + self.area_b)
        pressures = [(force + low * self.area_b) / self.area_a, low]
        self.oil = self.mbs.AddNode(
            self.items.NodeGenericODE1(
                referenceCoordinates=[0.0, 0.0], initialCoordinates=pressures, numberOfODE1Coordinates=2
            )
        )
        self.actuator = self.mbs.AddObject(
            self.items.HydraulicActuatorSimple(
                **{"markerNumbers": [base, rod], "nodeNumbers": [self.oil], "useChamberVolumeChange": True},
                **{"offsetLength": self.shortest, "strokeLength": m.stroke, "actuatorDamping": m.viscous},
                **{"chamberCrossSection0": self.area_a, "chamberCrossSection1": self.area_b},
                **{"hoseVolume0": m.dead_volume, "hoseVolume1": m.dead_volume, "oilBulkModulus": m.bulk_modulus},
                **{"nominalFlow": m.flow / math.sqrt(35e5), "systemPressure": m.supply, "tankPressure": m.tank},
            )
        )
        self.conductance = leak * LITRE_PER_MINUTE / 100e5
        self.leak = self.mbs.AddObject(
            self.items.ObjectGenericODE1(nodeNumbers=[self.oil], systemMatrix=np.zeros((2, 2)), rhsVector=[0.0, 0.0])
        )
        self.mbs.Assemble()

    def _slide(self, position: float) -> tuple[int, int, float]:
        """Markers of base and rod of a mass on a slide with a spring, and the force that holds it, N."""
        i, length, stiffness = self.items, self.shortest + self.machine.stroke / 2, 89e3
        node = self.mbs.AddNode(i.Node1D(referenceCoordinates=[0.0], initialCoordinates=[position]))
        body = self.mbs.AddObject(i.Mass1D(mass=63.0, nodeNumber=node, referencePosition=[length, 0.0, 0.0]))
        base = self.mbs.AddMarker(i.MarkerBodyPosition(bodyNumber=self.ground))
        rod = self.mbs.AddMarker(i.MarkerBodyPosition(bodyNumber=body))
        self._friction(node, 0, 1.0, position, stiffness)
        return base, rod, stiffness * position

    def _friction(self, node: int, coordinate: int, arm: float, start: float, stiffness: float = 0.0) -> None:
        """Bristles that hold one coordinate as the seal holds the rod at an arm, and a spring beside them."""
        i, m = self.items, self.machine
        moving = self.mbs.AddMarker(i.MarkerNodeCoordinate(nodeNumber=node, coordinate=coordinate))
        data = self.mbs.AddNode(i.NodeGenericData(initialCoordinates=[0.0, start, 0.0], numberOfDataCoordinates=3))
        self.mbs.AddObject(
            i.CoordinateSpringDamperExt(
                **{"markerNumbers": [self.still, moving], "nodeNumber": data, "frictionProportionalZone": 0.0},
                **{"stiffness": stiffness, "exponentialDecayStatic": 0.01 / arm},
                **{"dynamicFrictionForce": m.coulomb * arm, "staticFrictionOffsetForce": m.breakaway * arm},
                **{"stickingStiffness": 2e7 * arm**2, "stickingDamping": 2e4 * arm**2},
            )
        )

    def _boom(self, position: float, kind: str) -> tuple[int, int, float]:
        """The same of a boom that the cylinder lifts, rigid or with an elastic hinge."""
        i, length = self.items, self.shortest + self.machine.stroke / 2 + position
        cosine = (PIVOT_TO_ROD**2 + PIVOT_TO_BASE**2 - length**2) / (2 * PIVOT_TO_ROD * PIVOT_TO_BASE)
        angle = math.acos(cosine) - math.pi / 2
        arm = PIVOT_TO_ROD * PIVOT_TO_BASE * math.sqrt(1.0 - cosine**2) / length
        pivot = self.mbs.AddMarker(i.MarkerBodyPosition(bodyNumber=self.ground))
        place = [0.0, -PIVOT_TO_BASE, 0.0]
        base = self.mbs.AddMarker(i.MarkerBodyPosition(bodyNumber=self.ground, localPosition=place))
        node, boom, moment, _ = self._part(0.0, BOOM if kind == "rigid" else HINGE, kind == "rigid", angle, pivot)
        if kind == "flexible":
            end = self.mbs.AddMarker(i.MarkerBodyPosition(bodyNumber=boom, localPosition=[HINGE, 0.0, 0.0]))
            outer, _, outer_moment, inertia = self._part(HINGE, BOOM, True, angle, end)
            moment += outer_moment + (BOOM_MASS * (1.0 - HINGE / BOOM) + PAYLOAD) * GRAVITY * math.cos(angle) * HINGE
            rate = 2 * math.pi * HINGE_FREQUENCY
            turns = [i.MarkerNodeCoordinate(nodeNumber=number, coordinate=2) for number in (node, outer)]
            self.mbs.AddObject(  # it is straight where a run begins
                i.CoordinateSpringDamper(
                    markerNumbers=[self.mbs.AddMarker(turn) for turn in turns],
                    stiffness=inertia * rate**2,
                    damping=2 * HINGE_DAMPING * inertia * rate,
                    offset=outer_moment / (inertia * rate**2),
                )
            )
        self._friction(node, 2, arm, 0.0)
        rod = self.mbs.AddMarker(i.MarkerBodyPosition(bodyNumber=boom, localPosition=[PIVOT_TO_ROD, 0.0, 0.0]))
        return base, rod, moment / arm

    def _part(self, start: float, end: float, tip: bool, angle: float, joint: int) -> tuple[int, int, float, float]:
        """A part of the boom, hinged where it starts: node, body, its weight's moment (N m) and its inertia there."""
        i, length = self.items, end - start
        mass, load = BOOM_MASS * length / BOOM, PAYLOAD if tip else 0.0
        first = mass * length / 2 + load * length
        inertia = mass * length**2 / 3 + load * length**2
        place = [start * math.cos(angle), start * math.sin(angle), angle]
        node = self.mbs.AddNode(i.NodeRigidBody2D(referenceCoordinates=place))
        body = self.mbs.AddObject(
            i.RigidBody2D(mass=mass + load, inertia=inertia, centerOfMass=[first / (mass + load), 0.0], nodeNumber=node)
        )
        own = self.mbs.AddMarker(i.MarkerBodyPosition(bodyNumber=body))
        self.mbs.AddObject(i.RevoluteJoint2D(markerNumbers=[joint, own]))
        weight = self.mbs.AddMarker(i.MarkerBodyMass(bodyNumber=body))
        self.mbs.AddLoad(i.LoadMassProportional(markerNumber=weight, loadVector=[0.0, -GRAVITY, 0.0]))
        return node, body, first * GRAVITY * math.cos(angle), inertia

    def run(self, seconds: float, at_sample: Callable[[Floats], float], period: float, latency: float) -> None:
        """Simulate; ``at_sample`` gets position, pressures and spool, and answers with the command, -1 to 1.

        Everything between two steps of the solver follows its state at their boundary: spool, valve and leak.
        """
        m, out = self.machine, self.exu.OutputVariableType
        every, late, rate = round(period / STEP), round(latency / STEP), 2 * math.pi * m.frequency
        free = np.array([[0.0, 1.0], [-(rate**2), -2 * m.damping_ratio * rate]])
        decay = expm(free * STEP).tolist()
        spool, speed, waiting, acting, count = 0.0, 0.0, 0.0, 0.0, 0

        def before_step(mbs: Any, _: float) -> bool:
            nonlocal spool, speed, waiting, acting, count
            position = mbs.GetObjectOutput(self.actuator, out.Distance) - self.shortest - m.stroke / 2
            if count % every == 0:
                waiting = at_sample(np.array([position, *mbs.GetNodeOutput(self.oil, out.Coordinates), spool]))
            if count % every == late:
                acting = waiting
            away = spool - acting
            spool = acting + decay[0][0] * away + decay[0][1] * speed
            speed = decay[1][0] * away + decay[1][1] * speed
            mbs.SetObjectParameter(self.actuator, "valveOpening0", spool)
            mbs.SetObjectParameter(self.actuator, "valveOpening1", -spool)
            leak = self.conductance * m.bulk_modulus
            a = leak / (m.dead_volume + self.area_a * (m.stroke / 2 + position))
            b = leak / (m.dead_volume + self.area_b * (m.stroke / 2 - position))
            mbs.SetObjectParameter(self.leak, "systemMatrix", [[-a, a], [b, -b]])
            count += 1
            return True

        self.mbs.SetPreStepUserFunction(before_step)
        settings = self.exu.SimulationSettings()
        integration = settings.timeIntegration
        integration.endTime, integration.numberOfSteps, integration.verboseMode = seconds, round(seconds / STEP), 0
        integration.newton.numericalDifferentiation.minimumCoordinateSize = 1.0  # pressures are large
        integration.newton.useModifiedNewton = True
        integration.generalizedAlpha.spectralRadius = 0.95
        settings.solution.file.write = False
        self.mbs.SolveDynamic(settings)


def task_of(case: Case, folder: Path, name: str) -> TaskConfig:
    """The task with the rig of the nameplates, as a file."""
    file = folder / f"{name}.yaml"
    write_text(file, new_rig(answers_from({**case.nameplates, **case.told}), file.name)[0])
    return task_config(None, rig=file, control_period=case.period, command_latency=case.latency)


def controller_of(name: str, task: TaskConfig) -> Any:
    """A controller of the table."""
    if name == "flow_linearising":
        return FlowLinearising(FlowLinearisingGains(), task)
    if name == "searched":
        return make_controller("flow_linearising", task, searched_gains("flow_linearising", task).model_dump())
    if name == "pid":
        return make_controller("pid", task, gain_sets("pid", task)[0].model_dump())
    return load_controller("ppo", task, name)


class Run(NamedTuple):
    """One motion, a row per control period."""

    signals: Floats  # (n, 4), true values in the order of CHANNELS, SI
    measured: Floats  # (n, 4)
    command: Floats  # (n,), V
    reference: Floats  # (n,), m
    bias: float  # m, of the position's sensor

    def error(self) -> float:
        """Mean error in the sensor's frame, m."""
        return float(np.abs(self.signals[:, 0] + self.bias - self.reference).mean())


def sensed(task: TaskConfig, signals: Floats, late: Floats, noise: np.random.Generator, bias: Floats) -> Floats:
    """What the sensors of a rig read; ``late``: the pressures after their transducers' lag."""
    sensors = [getattr(task.sensors, name) for name in CHANNELS]
    values = np.array([signals[0], *late, signals[3]])
    if not task.sensors.enabled:
        return values
    read = values + bias + noise.normal(size=4) * [sensor.noise for sensor in sensors]
    steps = np.array([sensor.resolution or 1e-12 for sensor in sensors])
    return np.clip(np.round(read / steps) * steps, [one.low for one in sensors], [one.high for one in sensors])


def driven(case: Case, task: TaskConfig, controller: Controller, leak: float, wanted: Floats, seed: int) -> Run:
    """Follow a reference (m, a row per period) after the axis has settled where it begins."""
    loop, noise = OwnLoop(controller, task, si=True), np.random.default_rng(seed)
    bias = noise.uniform(-1.0, 1.0, 4) * [getattr(task.sensors, name).bias for name in CHANNELS]
    bias = bias * task.sensors.enabled
    settling, places = round(SETTLING / case.period), np.array([0, *task.preview_samples])
    path = np.concatenate([np.full(settling, wanted[0]), wanted, np.full(max(places), wanted[-1])])
    lag = math.exp(-case.period / (task.sensors.pressure_rise_time / math.log(9.0)))
    rows: list[Any] = []
    late = np.zeros(2)

    def at_sample(signals: Floats) -> float:
        nonlocal late
        late = lag * late + (1.0 - lag) * signals[1:3] if rows else signals[1:3]
        read = sensed(task, signals, late, noise, bias)
        volts = loop.step(path[len(rows) + places], **dict(zip(CHANNELS, map(float, read), strict=True)))
        rows.append((signals, read, volts))
        return volts / FULL_VOLTAGE

    Axis(case, float(wanted[0]), leak).run(
        len(wanted) * case.period + SETTLING - 0.5 * STEP, at_sample, case.period, case.latency
    )
    signals, read, volts = (np.array(column)[settling:] for column in zip(*rows, strict=True))
    return Run(signals, read, volts, wanted[: len(volts)], float(bias[0]))


def references(task: TaskConfig, seconds: float, families: Sequence[str]) -> Floats:
    """References of the project's families that the rig of the nameplates can follow, a row each, m."""
    exact = task_config(task, episode_duration=seconds, randomisation={})
    env = ServoHydraulicVectorEnv(len(families), exact, info=False)
    env.reset(seed=[SEED + number for number in range(len(families))], options={"reference": list(families)})
    wanted = np.array(env.axes.reference[:, : exact.steps])
    env.close()
    return wanted


def control_row(case: Case, task: TaskConfig, controller: Controller, leak: float, plain: TaskConfig) -> dict[str, Any]:
    """Error, travel of the valve and failures; of a flexible load also its swing after a step."""
    wanted = references(plain, SECONDS, MOVING_FAMILIES)
    runs = [driven(case, task, controller, leak, one, SEED + number) for number, one in enumerate(wanted)]
    row: dict[str, Any] = {
        "error_um": 1e6 * float(np.exp(np.mean([math.log(run.error()) for run in runs]))),
        "travel": float(np.mean([np.abs(np.diff(run.command)).mean() for run in runs])) / (FULL_VOLTAGE * case.period),
        "failures": sum(bool((np.abs(run.signals[:, 0]) > case.machine.stroke / 2).any()) for run in runs),
    }
    if case.kind == "flexible":
        exact = task_config(task, sensors={"enabled": False})
        step = np.full(round(10.0 / case.period), 0.002)
        step[0] = -0.002
        position = driven(case, exact, controller, leak, step, SEED).signals[:, 0]
        for second, part in enumerate(np.array_split(position, 10), 1):
            row[f"swing_{second}_um"] = 1e6 * float(np.ptp(part))
    return row


def leak_row(case: Case, task: TaskConfig, leak: float, plain: TaskConfig, file: Path) -> dict[str, Any]:
    """Alarms of the leakage head, and the verdict on a recording of flow linearisation."""
    controller = controller_of("flow_linearising", task)
    run = driven(case, task, controller, leak, references(plain, RECORDED, ["multi_sine"])[0], SEED)
    command = np.append(0.0, run.command[:-1])  # in the row in which it acts
    signals = np.vstack([run.measured.T, command / FULL_VOLTAGE])
    write_text(file, recording_csv(np.arange(len(command)) * case.period, signals))
    head = load_head(None, task)
    length = head.settings.window
    windows = np.stack([signals[:, at : at + length] for at in range(0, len(command) - length + 1, length)])
    found = head.estimate_windows(windows)
    verdict = diagnose(file, task, head).verdict
    return {
        "alarms": int((found.probability >= head.settings.threshold).sum()),
        "windows": len(windows),
        "verdict": verdict.line(),
    }


def rows_of(plant: str, name: str, leak: float, folder: Path) -> Iterator[dict[str, Any]]:
    """The row of one case."""
    case = PLANTS[plant]
    task, plain = task_of(case, folder, plant), task_of(case._replace(told={}), folder, case.kind)
    if name == LEAK:
        found = leak_row(case, task, leak, plain, folder / f"{plant}_{leak:g}.csv")
    else:
        found = control_row(case, task, controller_of(name, task), leak, plain)
    yield {"plant": plant, "controller": name, "leak": leak, **found}


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """One row per plant and controller: errors at each leak, and relative to those of untuned flow linearisation."""
    driven_rows = rows[rows["controller"] != LEAK]
    errors = driven_rows.pivot_table("error_um", ["plant", "controller"], "leak", sort=False)
    table = errors.rename(columns="error at {:g} l/min, µm".format)
    for leak in errors:
        first = errors[leak].unstack("controller").get("flow_linearising")
        if first is not None:
            table[f"÷ untuned at {leak:g} l/min"] = errors[leak] / first.reindex(errors.index, level="plant")
    table["travel, 1/s"] = driven_rows.groupby(["plant", "controller"])["travel"].mean()
    table["failures"] = driven_rows.groupby(["plant", "controller"])["failures"].sum()
    return table.round(3).reset_index()


def main() -> None:
    """Compute what is missing, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", nargs="+", choices=PLANTS, default=list(PLANTS))
    parser.add_argument("--controllers", nargs="+", choices=CONTROLLERS, default=list(CONTROLLERS))
    parser.add_argument("--leaks", nargs="+", type=float, choices=LEAKS, default=list(LEAKS), help="l/min at 100 bar")
    parser.add_argument("--output", type=Path, default=Path("results/foreign_plants"), help="folder")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    cases = list(itertools.product(PLANTS, CONTROLLERS, LEAKS))
    asked = set(itertools.product(given.plants, given.controllers, given.leaks))
    wanted = [number for number, case in enumerate(cases) if case in asked]

    def numbered(number: int) -> list[dict[str, Any]]:
        return [{"case": number, **row} for row in rows_of(*cases[number], given.output)]

    rows = kept_rows(given.output / "rows.csv", "case", wanted, numbered, given.jobs).sort_values("case")
    for table in (summary(rows), rows.filter(regex="plant|controller|leak|swing"), rows[rows["controller"] == LEAK]):
        table = table.dropna(axis="columns", how="all").dropna()
        if len(table) and len(table.columns) > 3:
            print(markdown(tuple(table), table.astype(str).to_numpy().tolist()), end="\n\n")


if __name__ == "__main__":
    main()
