"""A rig's file from nameplates: what it holds, what it computes, what it refuses, and how it asks."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest
import yaml
from command_line import COMMAND, ROOT, assert_one_clear_line, done, environment, hydro

from hydro_agents.learning import stable_gain
from hydro_agents.rigs.check_table import sensor_rows
from hydro_agents.rigs.rig_file import QUESTIONS, answers_from, new_rig
from hydro_env import PlantParameters, ServoHydraulicVectorEnv, equilibrium, simulate
from hydro_env.plant.analysis import speed_limits
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.parts.valve import edge_openings
from hydro_env.task.configuration import task_config
from hydro_env.task.rig import read_rig

LEAST = {
    "bore": "63 mm",
    "rod": "36mm",
    "stroke": "0.5 m",
    "rated_flow": "40 l/min",
    "supply_pressure": "160 bar",
    "mass": "200 kg",
}
EVERYTHING = {question.key: question.example for question in QUESTIONS} | {"bandwidth": "60 Hz"}


def made(**more):
    """The rig of the least answers and some more."""
    return new_rig(answers_from(LEAST | more), "rig.yaml")


def words(texts):
    return [f"{key.replace('_', '-')}={text}" for key, text in texts.items()]


def test_figures_that_were_given_stand_in_the_rig():
    _, rig = made(bandwidth="60 Hz", external_force="-2 kN", tank_pressure="3 bar")
    plant = rig.plant
    assert (plant.cylinder.bore_diameter, plant.cylinder.rod_diameter, plant.cylinder.stroke) == (0.063, 0.036, 0.5)
    assert plant.valve.rated_flow == pytest.approx(40e-3 / 60)
    assert plant.valve.natural_frequency == pytest.approx(2 * np.pi * 60)
    assert (plant.supply.pressure, plant.supply.tank_pressure, plant.supply.model) == (160e5, 3e5, "constant")
    assert (plant.load.mass, plant.load.external_force) == (200.0, -2000.0)


SURE = {"friction", "lines", "fluid.density", "valve.transition_pressure"}
"""Groups and fields that may keep the value of the paper's rig without a word."""

WITHOUT_EFFECT = {
    "leakage.external_resistance",
    "leakage.orifice_gain",  # of the task
    *("fluid.kinematic_viscosity", "lines.length_a", "lines.length_b"),  # lines without waves
    *("load.tip_share", "load.tip_frequency", "load.tip_damping_ratio"),  # a rigid load
    "valve.coil_inductance",  # the current follows at once
    "valve.knee_position",
    "valve.knee_opening",  # straight: both one half
    *(f"supply.{name}" for name in ("pump_flow", "relief_slope", "line_volume", "accumulator_volume")),
    *(f"supply.{name}" for name in ("precharge_pressure", "polytropic_index")),  # a constant supply
}


def test_all_that_is_not_given_has_a_range():
    """No number that matters comes from the paper's rig in silence."""
    text, rig = made()
    written, paper = yaml.safe_load(text), PlantParameters().model_dump()
    for group, fields in rig.plant.model_dump().items():
        for name, value in fields.items():
            path = f"{group}.{name}"
            if value == paper[group][name] and not {group, path} & (SURE | WITHOUT_EFFECT):
                assert path in rig.randomisation or name in written.get(group, {}), path
    for path in ("cylinder.dead_volume", "fluid.bulk_modulus", "fluid.air_fraction", "friction.coulomb_force"):
        assert path in rig.randomisation


@pytest.mark.parametrize("overlap", [{}, {"overlap": "10 %"}, {"edges": "sharp"}])
def test_the_null_flow_gives_the_underlap(overlap):
    """The valve then passes this flow at rest: both edges of each chamber in series, two chambers side by side."""
    text, rig = made(null_flow="1 l/min", **overlap)
    if "edges" not in overlap:
        assert "computed from a null flow of 1 l/min" in text
        assert rig.randomisation["valve.underlap"].factor == (0.3, 1.2)
    plant = rig.plant.replace(leakage={"internal_resistance": np.inf}, valve={"transition_pressure": 1.0})
    balanced = plant.replace(
        cylinder={"rod_diameter_a": plant.cylinder.rod_diameter}, supply={"tank_pressure": 0.0}
    )  # equal areas: half the supply in both chambers
    state, voltage = equilibrium(balanced, 0.0)
    run = simulate(balanced, np.full(20, voltage), 1e-3, state)
    assert run.supply_flow[-1] == pytest.approx(1e-3 / 60, rel=0.01)


@pytest.mark.parametrize(("overlap", "knee", "opening"), [(0.1, 0.4, 0.2), (0.0, 0.6, 0.4), (0.2, 0.5, 0.3)])
def test_a_flow_curve_gives_lap_and_knee(overlap, knee, opening):
    """Points of a known valve, rounded as a reader of a catalogue would, are met again."""
    valve = {"overlap": overlap, "knee_position": knee, "knee_opening": opening, "underlap": 0.0}
    known = plant_coefficients(PlantParameters().replace(valve={**valve, "null_shift": 0.0}))
    signals = [0.05, 0.15, 0.3, 0.45, 0.6, 0.8, 1.0]
    flows = [round(100 * edge_openings(signal, known)[0], 1) for signal in signals]
    text, rig = made(flow_curve=",".join(f"{100 * x:g}%:{y}%" for x, y in zip(signals, flows, strict=True)))
    found = plant_coefficients(rig.plant)
    assert rig.plant.valve.overlap == pytest.approx(overlap, abs=0.01)
    assert [100 * edge_openings(signal, found)[0] for signal in signals] == pytest.approx(flows, abs=1.0)
    assert "fitted to the flow curve; differs by up to 0" in text


@pytest.mark.parametrize(("beside", "lap"), [({"overlap": "5 %"}, 0.05), ({"edges": "sharp"}, 0.122)])
def test_what_is_given_beside_a_flow_curve_bends_it_no_further_than_the_file_says(beside, lap):
    """The points are met as closely as the origin of the knee tells; sharp edges keep the lap of the curve."""
    points = {0.15: 0.02, 0.4: 0.2, 0.7: 0.55, 1.0: 1.0}
    text, rig = made(flow_curve="15%:2%, 40%:20%, 70%:55%, 100%:100%", **beside)
    assert rig.plant.valve.overlap == pytest.approx(lap)
    assert "null flow" not in text
    valve = plant_coefficients(rig.plant.replace(valve={"underlap": 0.0, "null_shift": 0.0}))
    [told] = re.findall(r"knee_position: .* differs by up to (\S+) % of full flow", text)
    largest = max(abs(edge_openings(signal, valve)[0] - flow) for signal, flow in points.items())
    assert 100 * largest == pytest.approx(float(told), abs=0.1)


def test_the_command_tells_a_flow_curve_that_the_rig_meets_poorly(tmp_path):
    curves = {"good": "20%:4%, 50%:30%, 100%:100%", "poor": "20%:50%, 50%:70%, 80%:83%, 100%:100%"}
    for name, curve in curves.items():
        answer = done("new-rig", *words(LEAST), f"flow-curve={curve}", "--output", tmp_path / f"{name}.yaml")
        assert ("4.4 % of full flow" in answer.stdout) == (name == "poor")


def test_the_range_of_a_fitted_lap_is_an_allowed_one():
    _, rig = made(flow_curve="96%:1%, 99%:2%, 100%:100%")
    assert 0.0 < rig.plant.valve.overlap * rig.randomisation["valve.overlap"].factor[1] < 0.5
    _, rig = made(overlap="45 %", structure_frequency="6 Hz", structure_damping="0.9")
    assert rig.randomisation["valve.overlap"].factor == (0.8, 1.09)


@pytest.mark.parametrize("signal", ["5 V", "40 mA", "10 V"])
def test_the_full_signal_opens_the_valve_fully(signal):
    """A current is what the amplifier sends at 10 V; a voltage is the command itself."""
    _, rig = made(full_signal=signal)
    plant = rig.plant.replace(valve={"null_shift": 0.0})
    full = 5.0 if signal == "5 V" else 10.0
    run = simulate(plant, np.full(60, 0.6 * full), 5e-3, {"position": -0.2})
    assert run.spool_position[-1] == pytest.approx(0.6, abs=1e-3)
    if signal == "40 mA":
        assert run.coil_current[-1] == pytest.approx(0.6 * 0.040, rel=1e-3)


def test_sensors_are_those_that_were_given(tmp_path):
    """The accuracy class of a pressure sensor is its largest constant error."""
    given = {"pressure_range": "250 bar", "pressure_accuracy": "0.5 %", "position_noise": "0.02 mm"}
    text, _ = made(absent="spool_position", **given)
    (tmp_path / "rig.yaml").write_text(text)
    sensors = task_config(rig=tmp_path / "rig.yaml").sensors
    assert (sensors.pressure_a.high, sensors.pressure_b.high, sensors.position.noise) == (250e5, 250e5, 2e-5)
    assert (sensors.spool_position.fitted, sensors.pressure_b.fitted) == (False, True)
    assert (sensors.pressure_a.bias, sensors.pressure_b.bias) == pytest.approx((1.25e5, 1.25e5))
    assert sensors.pressure_a.noise == sensors.pressure_b.noise == pytest.approx(0.125e5)


@pytest.mark.parametrize("given", ["0.05 %", None])
def test_the_accuracy_of_the_position_is_asked_for_written_and_told(given, tmp_path):
    """Without an answer, the file and the table say what every study then assumes."""
    text, rig = made(**({"position_accuracy": given} if given else {}))
    (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
    largest, share, origin = (0.25, 0.05, "given") if given else (0.1, 0.02, "assumed")
    last = text.splitlines()[-1]
    assert last.startswith("#")
    assert last.endswith(f"(bias), {origin}: {largest} mm, {share} % of the stroke")
    task = task_config(rig=tmp_path / "rig.yaml")
    assert task.sensors.position.bias == pytest.approx(largest * 1e-3)
    row = sensor_rows(rig, task)[0]
    assert row.value == pytest.approx(largest)
    assert row.at == f"{'from the file' if given else 'assumed'}: {share} % of stroke"


def test_every_answer_is_read_and_plants_can_be_drawn_from_the_ranges(tmp_path):
    text, rig = new_rig(answers_from(EVERYTHING), "rig.yaml")
    (tmp_path / "rig.yaml").write_text(text)
    supply = rig.plant.supply
    assert (supply.model, supply.accumulator_volume, supply.precharge_pressure) == ("accumulator", 0.004, 130e5)
    assert read_rig(tmp_path / "rig.yaml").plant == rig.plant
    (tmp_path / "rig.yaml").write_text(made()[0])
    envs = ServoHydraulicVectorEnv(40, rig=tmp_path / "rig.yaml")
    observation, _ = envs.reset(seed=0)
    assert np.isfinite(observation).all()
    assert envs.axes.column("redraws").mean() < 0.2
    assert max(speed_limits(read_rig(tmp_path / "rig.yaml").plant)) < 1.0


def test_the_command_writes_a_file_that_check_rig_reads(tmp_path, monkeypatch):
    monkeypatch.setattr(stable_gain, "DRAWN", 3)
    monkeypatch.setattr(stable_gain, "PLANTS", 2)
    file = tmp_path / "mine.yaml"
    assert hydro("new-rig", *words(LEAST | {"pressure_range": "10 bar"}), "--output", file).returncode == 0
    assert_one_clear_line(hydro("new-rig", *words(LEAST), "--output", file), "--overwrite")
    assert "warning: sensors.pressure_a" in done("check-rig", "--rig", file).stdout


WRONG = {
    "decimal comma": ({"bore": "63,5 mm"}, "such as 63 mm"),
    "missing": ({"bore": None}, "bore"),
    "no unit": ({"rod": "36"}, "rod '36'"),
    "negative": ({"stroke": "-1 m"}, "stroke '-1 m'"),
    "too strong a force": ({"external_force": "90 kN"}, "load.external_force = 90000 N"),
    "no pump": ({"accumulator": "4 l"}, "pump-flow"),
    "more than everything": ({"overlap": "120 %"}, "0 to 100 %"),
    "a curve that falls": ({"flow_curve": "20%:30%, 50%:20%, 100%:100%"}, "that rise from 0 %"),
    "a curve in l/min": ({"flow_curve": "2 V:3 l/min"}, "flow-curve '2 V:3 l/min': "),
    "a curve that the model cannot hold": (
        {"flow_curve": "20%:60%,50%:70%,80%:75%,100%:100%"},
        "flow-curve '20%:60%,50%:70%,80%:75%,100%:100%': ",
    ),
    "a lap beside another curve": (
        {"flow_curve": "20%:20%, 50%:50%, 100%:100%", "overlap": "40 %"},
        "flow-curve '20%:20%, 50%:50%, 100%:100%': ",
    ),
    "a curve with semicolons": ({"flow_curve": "20%:4%;50%:30%;100%:100%"}, "such as 20%:4%, 50%:30%, 100%:100%"),
    "half a curve": ({"flow_curve": "0%:0%, 20%:4%, 50%:30%"}, "end at 100%:100%"),
    "no share that swings": ({"structure_frequency": "6 Hz", "structure_share": "0 %"}, "structure-share '0 %'"),
    "sensors at the valve without lines": ({"pressure_sensors": "valve"}, "line-length"),
    "an unknown sensor": ({"absent": "position"}, "absent 'position'"),
}


@pytest.mark.parametrize(("changes", "part"), WRONG.values(), ids=WRONG)
def test_wrong_figures_get_one_line_and_leave_no_file(changes, part, tmp_path):
    texts = {key: text for key, text in (LEAST | changes).items() if text is not None}
    assert_one_clear_line(hydro("new-rig", *words(texts), "--output", tmp_path / "rig.yaml"), part)
    assert not list(tmp_path.iterdir())


NEEDS_A_TERMINAL = pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal, which Windows has not")


def typed_on_a_terminal(lines, file):
    """Return code, standard output and standard error of the command that got these lines."""
    import pty

    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [*COMMAND, "new-rig", "--output", file],
        stdin=theirs,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment(),
        cwd=ROOT,
    )
    os.write(ours, ("\n".join(lines) + "\n").encode())
    shown, errors = process.communicate(timeout=300)
    for end in (ours, theirs):
        os.close(end)
    return process.returncode, shown.decode(), errors.decode()


@NEEDS_A_TERMINAL
def test_on_a_terminal_it_asks_again_until_it_can_read_the_answer(tmp_path):
    typed = {**LEAST, "absent": "spool_position"}
    file = tmp_path / "rig.yaml"
    answers = [typed.get(question.key, "") for question in QUESTIONS]
    code, shown, _ = typed_on_a_terminal(["63", *answers], file)
    assert code == 0
    assert read_rig(file).plant.cylinder.rod_diameter == 0.036
    assert shown.count("Diameter of the bore. (required, such as 63 mm)") == 2
    assert read_rig(file).plant.cylinder.bore_diameter == 0.063
    assert read_rig(file).sensors == {"sensors.spool_position.fitted": False}


def test_a_table_of_nameplates_becomes_files_of_rigs_and_says_what_lacks(tmp_path):
    (tmp_path / "plates.csv").write_text(
        "axis;bore [mm];rod [mm];stroke [mm];rated-flow [l/min];supply pressure [bar];mass [kg];place;"
        "flow-curve [%]\n"
        "press;50,5;28;400;40;16 MPa;100;hall 1;20%:4%,50%:30%,100%:100%\n"
        "lift;50;28;400;;160;100;hall 2\n"
        "tilt;50;28;400;40;160;100;hall 2;20:4,50:30,100:100\n",
        encoding="utf-16",
    )
    answer = hydro("new-rig", "--table", tmp_path / "plates.csv", "-o", tmp_path / "rigs")
    assert answer.returncode == 2
    assert "lift: not written: rated-flow" in answer.stdout
    assert "place" in answer.stdout
    assert "tilt: not written: flow-curve '20:4,50:30,100:100': " in answer.stdout
    assert {path.name for path in (tmp_path / "rigs").iterdir()} == {"press.yaml", "fleet.yaml"}
    assert yaml.safe_load((tmp_path / "rigs" / "fleet.yaml").read_text()) == {"axes": {"press": {"rig": "press.yaml"}}}
    rig = read_rig(tmp_path / "rigs" / "press.yaml")
    assert rig.plant.cylinder.bore_diameter == pytest.approx(0.0505)
    assert rig.plant.supply.pressure == pytest.approx(160e5)
    assert_one_clear_line(hydro("new-rig", "--table", tmp_path / "plates.csv", "-o", tmp_path / "rigs"), "exists")
