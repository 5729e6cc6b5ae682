"""Controllers on axes of Exudyn, a simulator that nobody here wrote.

    pip install "hydro_env[foreign]"
    python -m benchmarks.foreign_plants [--plants slide rigid_crane flexible_crane flexible_crane_told]
        [--controllers flow_linearising searched pid policy] [--output results/foreign_plants]

Rigs come from nameplates alone, as ``hydro new-rig`` makes them; what Exudyn simulates differs from them as usual
machines do. ``flexible_crane_told`` is the flexible crane whose nameplates name the frequency of its structure. The
folder keeps the rows; a later call computes what is missing. real_machines.py reads recordings of such axes.
"""

import importlib
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import expm

from benchmarks import command_line, kept_rows
from benchmarks.any_axis import FIGURES, POLICY, SEARCHED, controllers_on
from hydro_agents.controllers.own_loop import OwnLoop
from hydro_agents.evaluation import drawn_rigs
from hydro_agents.rigs.rig_file import answers_from, new_rig
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.text import markdown
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.files import read_yaml, write_text
from hydro_env.task.configuration import task_config
from hydro_env.task.reference_signals import MOVING_FAMILIES
from hydro_env.task.sensors import CHANNELS
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE

SECONDS, SETTLING, RESTING = 2.0, 0.5, 10.0  # of a motion, before it, after a step
SLOW = {"speed_share": 0.35, "acceleration_limit": 1.0, "step_range": [0.002, 0.005]}  # Exudyn's oil never cavitates
SEED, GRAVITY = 11, 9.81
UNTUNED = "flow_linearising"
CONTROLLERS = {UNTUNED: drawn_rigs.UNTUNED, "searched": SEARCHED, "pid": FIGURES, "policy": POLICY}
LEAKS = (0.01, 1.0)  # l/min at 100 bar: healthy, worn

ROD, BASE = 0.5, 1.0  # m, mounts of the cylinder: along the boom, and straight below its pivot
BOOM, BOOM_MASS, PAYLOAD = 1.6, 40.0, 120.0  # m, kg, and kg at its end
HINGE, HINGE_RATE, HINGE_DAMPING = 0.8, 2 * math.pi * 6.0, 0.01  # m, rad/s and damping ratio of the outer part alone
BRISTLE_STIFFNESS, BRISTLE_DAMPING, STRIBECK_VELOCITY = 2e7, 2e4, 0.01  # N/m, N s/m, m/s
SPRING = 89e3  # N/m, of the slide


class Machine(NamedTuple):
    """An axis of Exudyn, and the nameplates of its rig; pressures are gauge pressures."""

    kind: str  # of load
    period: float  # s
    latency: float  # s
    dead_volume: float  # m³, each side
    flow: float  # l/min at 35 bar over one edge
    frequency: float  # Hz, of the spool
    supply: float  # Pa
    viscous: float  # N s/m
    coulomb: float  # N
    breakaway: float  # N, beyond the Coulomb force
    nameplates: Mapping[str, str]
    told: Mapping[str, str] = {}  # beyond those from which references follow
    tank: float = 2e5  # Pa
    stroke: float = 0.4  # m
    bulk_modulus: float = 1.1e9  # Pa
    damping_ratio: float = 0.7  # of the spool
    step: float = 2e-4  # s, of Exudyn's implicit integrator; it divides period and latency

    def areas(self) -> tuple[float, float]:
        """Areas of the piston, m²."""
        bore, rod = (answers_from(self.nameplates)[name] for name in ("bore", "rod"))
        return math.pi / 4 * bore**2, math.pi / 4 * (bore**2 - rod**2)


PLANTS = {name: Machine(**fields) for name, fields in read_yaml(Path(__file__).with_suffix(".yaml")).items()}


class Axis:
    """A machine in Exudyn that begins at rest at a position, m from mid-stroke, with a leak, l/min at 100 bar."""

    def __init__(self, machine: Machine, position: float, leak: float) -> None:
        self.exudyn, self.items = (importlib.import_module(name) for name in ("exudyn", "exudyn.itemInterface"))
        self.system = self.exudyn.SystemContainer().AddSystem()
        self.machine, m, (area_a, area_b) = machine, machine, machine.areas()
        self.shortest = math.hypot(ROD, BASE) - m.stroke / 2  # m; the boom is level at mid-stroke
        self.ground = self.new("ObjectGround")
        base, rod, force = self.slide(position) if m.kind == "slide" else self.boom(position)
        low = 0.5 * (m.supply + m.tank) * area_a / (area_a + area_b)
        start = [(force + low * area_b) / area_a, low]
        oil = {"referenceCoordinates": [0, 0], "initialCoordinates": start, "numberOfODE1Coordinates": 2}
        self.oil = self.new("NodeGenericODE1", **oil)
        self.actuator = self.new(
            "HydraulicActuatorSimple",
            **{"markerNumbers": [base, rod], "nodeNumbers": [self.oil], "useChamberVolumeChange": True},
            **{"offsetLength": self.shortest, "strokeLength": m.stroke, "actuatorDamping": m.viscous},
            **{"chamberCrossSection0": area_a, "chamberCrossSection1": area_b, "oilBulkModulus": m.bulk_modulus},
            **{"hoseVolume0": m.dead_volume, "hoseVolume1": m.dead_volume},
            **{"nominalFlow": m.flow * LITRE_PER_MINUTE / math.sqrt(35e5)},
            **{"systemPressure": m.supply, "tankPressure": m.tank},
        )
        self.conductance = leak * LITRE_PER_MINUTE / 100e5
        self.seal = self.new("ObjectGenericODE1", nodeNumbers=[self.oil], systemMatrix=np.zeros((2, 2)))
        self.system.Assemble()

    def new(self, kind: str, **fields: Any) -> int:
        """Add an item of Exudyn to the system."""
        add = {"Node": "AddNode", "Mark": "AddMarker", "Load": "AddLoad"}.get(kind[:4], "AddObject")
        number: int = getattr(self.system, add)(getattr(self.items, kind)(**fields))
        return number

    def slide(self, position: float) -> tuple[int, int, float]:
        """A mass on a slide with a spring: markers of base and rod, and the force that holds it, N."""
        node = self.new("Node1D", referenceCoordinates=[0], initialCoordinates=[position])
        place = [self.shortest + self.machine.stroke / 2, 0, 0]
        body = self.new("Mass1D", mass=63.0, nodeNumber=node, referencePosition=place)
        self.seal_friction(node, 0, 1.0, position, SPRING)
        base, rod = (self.new("MarkerBodyPosition", bodyNumber=number) for number in (self.ground, body))
        return base, rod, SPRING * position

    def boom(self, position: float) -> tuple[int, int, float]:
        """The same of a boom that the cylinder lifts, rigid or with an elastic hinge."""
        length = self.shortest + self.machine.stroke / 2 + position
        cosine = (ROD**2 + BASE**2 - length**2) / (2 * ROD * BASE)
        angle, arm = math.acos(cosine) - math.pi / 2, ROD * BASE * math.sqrt(1 - cosine**2) / length
        pivot = self.new("MarkerBodyPosition", bodyNumber=self.ground)
        base = self.new("MarkerBodyPosition", bodyNumber=self.ground, localPosition=[0, -BASE, 0])
        if self.machine.kind == "rigid":
            node, body, _, _ = self.part(0.0, BOOM, PAYLOAD, angle, pivot)
        else:
            node, body, _, _ = self.part(0.0, HINGE, 0.0, angle, pivot)
            end = self.new("MarkerBodyPosition", bodyNumber=body, localPosition=[HINGE, 0, 0])
            outer, _, moment, inertia = self.part(HINGE, BOOM, PAYLOAD, angle, end)
            turns = [self.new("MarkerNodeCoordinate", nodeNumber=number, coordinate=2) for number in (node, outer)]
            stiffness, damping = inertia * HINGE_RATE**2, 2 * HINGE_DAMPING * inertia * HINGE_RATE
            self.new(  # straight where a run begins
                "CoordinateSpringDamper",
                **{"markerNumbers": turns, "stiffness": stiffness, "damping": damping, "offset": moment / stiffness},
            )
        self.seal_friction(node, 2, arm, 0.0)
        rod = self.new("MarkerBodyPosition", bodyNumber=body, localPosition=[ROD, 0, 0])
        return base, rod, (BOOM_MASS / 2 + PAYLOAD) * BOOM * GRAVITY * math.cos(angle) / arm

    def part(self, start: float, end: float, load: float, angle: float, joint: int) -> tuple[int, int, float, float]:
        """A part of the boom, hinged where it starts: node, body, moment of its weight, N m, and inertia there."""
        length, mass = end - start, BOOM_MASS * (end - start) / BOOM
        first, inertia = (mass / 2 + load) * length, (mass / 3 + load) * length**2
        place = [start * math.cos(angle), start * math.sin(angle), angle]
        node = self.new("NodeRigidBody2D", referenceCoordinates=place)
        centre = [first / (mass + load), 0]
        body = self.new("RigidBody2D", mass=mass + load, inertia=inertia, centerOfMass=centre, nodeNumber=node)
        own = self.new("MarkerBodyPosition", bodyNumber=body)
        self.new("RevoluteJoint2D", markerNumbers=[joint, own])
        weight = self.new("MarkerBodyMass", bodyNumber=body)
        self.new("LoadMassProportional", markerNumber=weight, loadVector=[0, -GRAVITY, 0])
        return node, body, first * GRAVITY * math.cos(angle), inertia

    def seal_friction(self, node: int, coordinate: int, arm: float, start: float, stiffness: float = 0.0) -> None:
        """Bristles that act on a coordinate as the seal does on the rod at an arm, and a spring beside them."""
        point, m = self.new("NodePointGround"), self.machine
        places = ((point, 0), (node, coordinate))
        ends = [self.new("MarkerNodeCoordinate", nodeNumber=one, coordinate=axis) for one, axis in places]
        data = self.new("NodeGenericData", initialCoordinates=[0, start, 0], numberOfDataCoordinates=3)
        self.new(
            "CoordinateSpringDamperExt",
            **{"markerNumbers": ends, "nodeNumber": data, "stiffness": stiffness, "frictionProportionalZone": 0.0},
            **{"dynamicFrictionForce": m.coulomb * arm, "staticFrictionOffsetForce": m.breakaway * arm},
            **{"stickingStiffness": BRISTLE_STIFFNESS * arm**2, "stickingDamping": BRISTLE_DAMPING * arm**2},
            **{"exponentialDecayStatic": STRIBECK_VELOCITY / arm},
        )

    def run(self, seconds: float, at_sample: Callable[[Floats], float]) -> None:
        """Simulate; ``at_sample`` answers to the true values, in the order of CHANNELS, with a command, -1 to 1.

        The spool moves between the solver's steps, and the stiffness of the oil beside the leak between samples.
        """
        m, output = self.machine, self.exudyn.OutputVariableType
        every, late, rate = round(m.period / m.step), round(m.latency / m.step), 2 * math.pi * m.frequency
        decay = expm(np.array([[0.0, 1.0], [-(rate**2), -2 * m.damping_ratio * rate]]) * m.step).tolist()
        spool, speed, sent, acting, count, (area_a, area_b) = 0.0, 0.0, 0.0, 0.0, 0, m.areas()

        def before_step(system: Any, _: float) -> bool:
            nonlocal spool, speed, sent, acting, count
            position = system.GetObjectOutput(self.actuator, output.Distance) - self.shortest - m.stroke / 2
            if count % every == 0:
                a = self.conductance * m.bulk_modulus / (m.dead_volume + area_a * (m.stroke / 2 + position))
                b = self.conductance * m.bulk_modulus / (m.dead_volume + area_b * (m.stroke / 2 - position))
                system.SetObjectParameter(self.seal, "systemMatrix", [[-a, a], [b, -b]])
                sent = at_sample(np.array([position, *system.GetNodeOutput(self.oil, output.Coordinates), spool]))
            if count % every == late:
                acting = sent
            away, count = spool - acting, count + 1
            spool = acting + decay[0][0] * away + decay[0][1] * speed
            speed = decay[1][0] * away + decay[1][1] * speed
            system.SetObjectParameter(self.actuator, "valveOpening0", spool)
            system.SetObjectParameter(self.actuator, "valveOpening1", -spool)
            return True

        self.system.SetPreStepUserFunction(before_step)
        settings = self.exudyn.SimulationSettings()
        settings.solution.file.write, integration = False, settings.timeIntegration
        integration.endTime, integration.numberOfSteps = seconds, round(seconds / m.step)
        integration.adaptiveStep, newton = False, integration.newton  # a repeated step would call twice
        newton.numericalDifferentiation.minimumCoordinateSize = 1.0  # of pressures
        newton.relativeTolerance, newton.absoluteTolerance, newton.maxIterations = 1e-5, 1e-3, 50
        newton.useModifiedNewton, integration.generalizedAlpha.spectralRadius = True, 0.95
        self.system.SolveDynamic(settings, showHints=False)


def task_of(machine: Machine, folder: Path, name: str) -> TaskConfig:
    """The task with the rig of the nameplates, whose file the folder keeps."""
    file = folder / f"{name}.yaml"
    write_text(file, new_rig(answers_from({**machine.nameplates, **machine.told}), file.name)[0])
    return task_config(None, rig=file, control_period=machine.period, command_latency=machine.latency)


def controller_of(name: str, task: TaskConfig) -> Any:
    """A controller of the table."""
    return controllers_on(task, str(pretrained_folder() / "policy_any_axis"), None)[CONTROLLERS[name]]()


def driven(
    machine: Machine, task: TaskConfig, controller: Any, leak: float, wanted: Floats, seed: int
) -> tuple[Floats, Floats, float]:
    """Follow a reference (m, one per period) after the axis has settled where it begins.

    Returns the true signals in the order of CHANNELS (n, 4), commands (n,), and the error in its sensor, m.
    """
    loop, draws = OwnLoop(controller, task, si=True), np.random.default_rng(seed)
    fields = ("noise", "bias", "resolution", "low", "high")
    noise, bias, steps, low, high = np.array(
        [[getattr(getattr(task.sensors, name), field) for name in CHANNELS] for field in fields]
    )
    bias = draws.uniform(-1.0, 1.0, 4) * bias * task.sensors.enabled
    settling, places = round(SETTLING / machine.period), np.array([0, *task.preview_samples])
    path = np.concatenate([np.full(settling, wanted[0]), wanted, np.full(max(places) + 1, wanted[-1])])
    lag = math.exp(-machine.period * math.log(9.0) / max(task.sensors.pressure_rise_time, 1e-9))
    rows: list[tuple[Floats, float]] = []
    late = np.zeros(4)

    def at_sample(true: Floats) -> float:
        late[:] = true + [0.0, lag, lag, 0.0] * (late - true) * bool(rows)
        read = late.copy()
        if task.sensors.enabled:
            read = np.clip(np.round((late + bias + noise * draws.normal(size=4)) / steps) * steps, low, high)
        volts = loop.step(path[len(rows) + places], **dict(zip(CHANNELS, map(float, read), strict=True)))
        rows.append((true, volts / FULL_VOLTAGE))
        return volts / FULL_VOLTAGE

    Axis(machine, float(wanted[0]), leak).run((settling + len(wanted)) * machine.period, at_sample)
    true, command = (np.array(column[settling:][: len(wanted)]) for column in zip(*rows, strict=True))
    return true, command, float(np.abs(true[:, 0] + bias[0] - wanted).mean())


def references(task: TaskConfig, seconds: float, families: Sequence[str]) -> Floats:
    """References of the project's families that the rig of the nameplates can follow, a row each, m."""
    exact = task_config(task, episode_duration=seconds, randomisation={}, references=SLOW)
    env = ServoHydraulicVectorEnv(len(families), exact, info=False)
    env.reset(seed=[SEED + number for number in range(len(families))], options={"reference": list(families)})
    wanted = np.array(env.axes.reference[:, : exact.steps])
    env.close()
    return wanted


def control_row(machine: Machine, task: TaskConfig, name: str, leak: float, plain: TaskConfig) -> dict[str, Any]:
    """Error, travel of the valve, failures; of a healthy flexible axis also its swing after a step without noise."""
    controller, wanted = controller_of(name, task), references(plain, SECONDS, MOVING_FAMILIES)
    runs = [driven(machine, task, controller, leak, one, SEED + number) for number, one in enumerate(wanted)]
    row: dict[str, Any] = {
        "error_um": 1e6 * math.exp(np.mean([math.log(error) for *_, error in runs])),
        "travel": float(np.mean([np.abs(np.diff(command)).mean() for _, command, _ in runs])) / machine.period,
        "failures": sum(bool((np.abs(true[:, 0]) > machine.stroke / 2).any()) for true, *_ in runs),
    }
    if machine.kind == "flexible" and leak == LEAKS[0]:
        step = np.append(-0.002, np.full(round(RESTING / machine.period) - 1, 0.002))
        exact = task_config(task, sensors={"enabled": False})
        position = driven(machine, exact, controller, leak, step, SEED)[0][:, 0]
        for second, part in enumerate(np.array_split(position, round(RESTING)), 1):
            row[f"swing_{second}_um"] = round(1e6 * float(np.ptp(part)), 1)
    return row


def row_of(leak: float, name: str, plant: str, folder: Path) -> dict[str, Any]:
    """The row of one case."""
    machine = PLANTS[plant]
    task, plain = task_of(machine, folder, plant), task_of(machine._replace(told={}), folder, machine.kind)
    return {"plant": plant, "controller": name, "leak": leak, **control_row(machine, task, name, leak, plain)}


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of the controllers, with their errors relative to those of untuned flow linearisation."""
    first = rows[rows["controller"] == UNTUNED].set_index(["plant", "leak"])["error_um"]
    places = pd.MultiIndex.from_frame(rows[["plant", "leak"]])
    return rows.assign(ratio=rows["error_um"] / first.reindex(places).to_numpy())


def main() -> None:
    """Compute what is missing, and print the tables."""
    output = Path("results/foreign_plants")
    given = command_line(__doc__, plants=PLANTS, controllers=CONTROLLERS, output=output, jobs=1)
    cases = list(itertools.product(LEAKS, CONTROLLERS, PLANTS))
    asked = set(itertools.product(LEAKS, given.controllers, given.plants))
    wanted = [number for number, case in enumerate(cases) if case in asked]

    def rows_of(number: int) -> list[dict[str, Any]]:
        return [{"case": number, **row_of(*cases[number], given.output)}]

    rows = kept_rows(given.output / "rows.csv", "case", wanted, rows_of, given.jobs).sort_values(["plant", "case"])
    shown = summary(rows).drop(columns="case").dropna(axis="columns", how="all").round(3).astype(str)
    print(markdown(tuple(shown), [[str(cell) for cell in row] for row in shown.to_numpy()]))


if __name__ == "__main__":
    main()
