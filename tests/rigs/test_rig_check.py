"""``hydro check-rig``: the figures are the known ones, the files hold them, wrong rigs get one line."""

import csv
import math
from pathlib import Path

import pytest
from command_line import ROOT, assert_one_clear_line, hydro, hydro_process

from hydro_agents.controllers.pid import PIDGains
from hydro_agents.controllers.sampled_loop import places_in_reach, sampled_loop
from hydro_agents.rigs.check import beyond_dead_band, check_rig, pid_from_figures, stable_start
from hydro_agents.rigs.check_table import assumed, brief, check_csv, check_markdown
from hydro_agents.study.settings import default_study
from hydro_env import PlantParameters
from hydro_env.plant.analysis import speed_limits
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.kernel import STABLE_PRODUCT
from hydro_env.plant.parts.valve import edge_openings
from hydro_env.plant.probe import probe
from hydro_env.task.configuration import task_config

ROWS = check_rig(PlantParameters())


def figure(quantity, at=""):
    [value] = [row.value for row in ROWS if row.quantity == quantity and row.at == at]
    return value


@pytest.mark.parametrize(
    ("quantity", "at", "value", "tolerance"),
    [
        ("area a (bore side)", "", 12.566, 1e-3),
        ("area b (rod side)", "", 6.409, 1e-3),
        ("area ratio a/b", "", 1.961, 1e-3),
        ("gain K of one edge", "fully open", 10 / math.sqrt(35), 1e-9),
        ("rated flow", "70 bar over both edges", 10.0, 1e-9),
        ("no-load flow", "69 bar over both edges", 10 * math.sqrt(69 / 70), 1e-9),
        ("no-load speed out", "fully open", 175.6, 1e-3),
        ("speed out", "2/3 of force limit", 175.6 / math.sqrt(3), 1e-3),
        ("no-load speed in", "fully open", 124.1, 1e-3),
        ("spool at 10 V", "full = 1", 1.0, 1e-9),
        ("lasting speed out", "fed by the pump alone", 1e3 * 2.15e-4 / 12.566e-4, 1e-3),
        ("lasting speed in", "fed by the pump alone", 124.1, 1e-3),
        ("force limit out", "70 bar", 8.732, 1e-3),
        ("reach in", "spring 89 N/mm", -49.0, 1e-3),
        ("oil in chamber a", "mid-stroke", 30 + 12.566 * 20, 1e-3),
        ("damping ratio, linearised", "mid-stroke, 0.01 l/min", 0.0087, 1e-2),
    ],
)
def test_known_figures(quantity, at, value, tolerance):
    assert figure(quantity, at) == pytest.approx(value, rel=tolerance)


def test_the_formulas_of_the_page_give_the_same_figures():
    """docs/own_rig.md, The calculation by hand; the friction-free axis without leak, oil without air."""
    rig = PlantParameters().replace(fluid={"air_fraction": 0.0}, lines={"volume_a": 1e-4, "wall_bulk_modulus": 3e8})
    found = {row.quantity: row.value for row in check_rig(rig) if row.at in ("fully open", "x = +100.0 mm")}
    area_a, area_b = math.pi / 4 * 0.04**2, math.pi / 4 * (0.04**2 - 0.028**2)
    ratio, supply, tank = area_a / area_b, rig.supply.pressure, rig.supply.tank_pressure
    gain = rig.valve.rated_flow / math.sqrt(rig.valve.rated_pressure_drop / 2)
    out = gain / area_a * math.sqrt((ratio**3 * supply - ratio**2 * tank) / (1 + ratio**3))
    back = gain / area_b * math.sqrt((supply - ratio * tank) / (1 + ratio**3))
    assert found["no-load speed out"] == pytest.approx(1e3 * out, rel=2e-3)
    assert found["no-load speed in"] == pytest.approx(1e3 * back, rel=2e-3)
    volume_a, volume_b = (rig.cylinder.dead_volume + area * way for area, way in ((area_a, 0.3), (area_b, 0.1)))
    soft_a = (volume_a + 1e-4) / rig.fluid.bulk_modulus + 1e-4 / 3e8
    soft_b = (volume_b + rig.lines.volume_b) / rig.fluid.bulk_modulus + rig.lines.volume_b / 3e8
    mass, spring = rig.load.mass + rig.cylinder.piston_mass, rig.load.spring_stiffness
    frequency = math.sqrt((area_a**2 / soft_a + area_b**2 / soft_b + spring) / mass) / (2 * math.pi)
    assert found["natural frequency, ports shut"] == pytest.approx(frequency, rel=2e-3)


def test_leakage_damps_adds_margin_and_softens():
    def over_leaks(quantity, at):
        return [figure(quantity, at.format(leak)) for leak in ("0.01", "0.3", "1", "4")]

    for quantity in ("damping ratio, linearised", "largest stable gain (5 ms, 1 ms late)"):
        values = over_leaks(quantity, "mid-stroke, {} l/min")
        assert values == sorted(values)
    stiffness = over_leaks("static stiffness", "half of it, mid-stroke, {} l/min")
    assert stiffness == sorted(stiffness, reverse=True)


def rows_of(**changes):
    rows = check_rig(PlantParameters().replace(**changes))
    return {(row.quantity, row.at): row.value for row in rows}


def test_the_integration_rows_tell_what_the_integrator_did():
    rows = {(row.quantity, row.at): row.value for row in ROWS if row.group == "integration"}
    run = "±10 V in turn from mid-stroke"
    found = probe(PlantParameters())
    assert rows["longest stable step", "mid-stroke"] == pytest.approx(
        1e3 * STABLE_PRODUCT / rows["fastest rate |λ|, bound", "mid-stroke (chamber b)"]
    )
    assert rows["fastest rate |λ|, at rest", "mid-stroke"] <= rows["fastest rate |λ|, bound", "mid-stroke (chamber b)"]
    assert rows["inner steps in 5 ms, mean", run] == found.mean_steps
    assert rows["inner steps in 5 ms, most", run] == found.most_steps
    assert rows["mean inner step", run] == pytest.approx(5.0 / found.mean_steps)
    assert rows["is the inner step small enough", "error ≤ 0.0001"] == "yes"
    told = next(row for row in ROWS if row.quantity.startswith("estimated error"))
    assert told.value == found.error
    assert told.quantity == f"estimated error ({found.state.replace('_', ' ')})"


CIRCUITS = {
    "ideal valve": {"valve": {"model": "ideal"}},
    "pump": {"supply": {"model": "pump"}},
    "pump standing": {"supply": {"pump_flow": 0.0}},
    "line alone": {"supply": {"model": "pump", "pump_flow": 0.0, "relief_slope": 0.0}},
    "lugre": {"friction": {"model": "lugre"}},
    "constant supply": {"supply": {"model": "constant"}},
    "no spring": {"load": {"spring_stiffness": 0.0}},
    "no leak": {"leakage": {"internal_resistance": math.inf}},
}


@pytest.mark.parametrize("changes", CIRCUITS.values(), ids=CIRCUITS)
def test_every_circuit_is_checked(changes):
    rows = rows_of(**changes)
    assert rows["is the inner step small enough", "error ≤ 0.0001"] == "yes"
    numbers = [value for value in rows.values() if not isinstance(value, str)]
    assert all(math.isfinite(value) for value in numbers)
    pump = rows.get(("flow of the pump", ""))
    supply = PlantParameters().replace(**changes).supply
    assert pump == (None if supply.model == "constant" else pytest.approx(supply.pump_flow * 6e4))


def test_what_has_no_limit_is_said_in_words():
    rows = rows_of(valve={"amplifier_gain": 0.625e-2, "rated_flow": 1e-6})
    assert rows["largest stable gain (5 ms, 1 ms late)", "mid-stroke, 0.01 l/min"] == "unlimited"
    assert rows["spool at 10 V", "full = 1"] == pytest.approx(0.01)


def test_every_number_has_a_unit_and_its_place():
    assert all(row.unit for row in ROWS if not isinstance(row.value, str))
    assert len({row[:3] for row in ROWS}) == len(ROWS)
    table = list(csv.DictReader(check_csv(ROWS).splitlines()))
    assert [row["quantity"] for row in table] == [row.quantity for row in ROWS]
    text = check_markdown(ROWS, "title")
    assert all(line.replace("\\|", "").count("|") == 6 for line in text.splitlines() if line.startswith("|"))


def test_the_command_prints_and_writes(tmp_path):
    for rig in sorted((ROOT / "configs" / "rigs").glob("*.yaml")):
        result = hydro("check-rig", "--rig", rig, "--output", tmp_path / rig.stem)
        assert result.returncode == 0, result.stderr
        assert rig.name in result.stdout
        assert "largest stable gain" in result.stdout
        assert (tmp_path / rig.stem / "check.csv").stat().st_size > 1000
        assert (tmp_path / rig.stem / "check.md").read_text(encoding="utf-8").startswith(f"# {rig.name}")
    again = hydro("check-rig", "--output", tmp_path / "kovari_2015")
    assert_one_clear_line(again, "holds results already")


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (
            "load: {spring_stiffness: 1e8}",
            ["rig.yaml: load.spring_stiffness = 1e+08 N/m", "the limit is 8.732e+06 N/m"],
        ),
        ("friction: {transition_velocity: 1e-6}", ["friction.transition_velocity", "the limit is 4,000"]),
        ("cylinder: {rod_diameter_a: 0.05}", ["rod_diameter_a = 0.05 m does not fit"]),
        ("supply: {tank_pressure: 80e5}", ["must be above tank_pressure"]),
        ("supply: {precharge_pressure: 75e5}", ["precharge_pressure", "must be below pressure"]),
    ],
)
def test_rigs_that_cannot_work(tmp_path, content, parts):
    (tmp_path / "rig.yaml").write_text(content.replace("1e8", "1.0e+8").replace("1e-6", "1.0e-6"))
    commands = ("check-rig", "simulate") if "limit" in parts[-1] else ("check-rig",)
    for command in commands:
        result = hydro(command, "--rig", tmp_path / "rig.yaml", "--output", tmp_path / "run")
        assert_one_clear_line(result, *parts)
        assert result.stdout == ""
    assert not (tmp_path / "run").exists()


def test_six_lines_say_the_main_figures_in_units_of_the_workshop():
    lines = dict(brief(ROWS, PlantParameters()))
    assert list(lines) == ["speeds", "forces", "natural frequency", "damping ratio", "largest stable gain", "verdict"]
    assert lines["speeds"].startswith("176 mm/s out, 124 mm/s in")
    assert lines["forces"].startswith("8.73 kN out, 4.36 kN in; it reaches -49 to 98.1 mm")
    worst = next(row.value for row in ROWS if row.quantity == "largest stable gain" and "0.01 l/min" in row.at)
    mean_speed = 0.5e-3 * (figure("no-load speed out", "fully open") + figure("no-load speed in", "fully open"))
    assert f"{worst * 10 / 1000:.3g} V/mm (K_v = {worst * mean_speed:.3g} 1/s)" in lines["largest stable gain"]
    assert "the pump alone sustains only 171 mm/s out" in lines["verdict"]
    assert "the axis rings" in lines["verdict"]


def test_a_damped_axis_with_a_strong_pump_simply_works():
    rig = PlantParameters().replace(load={"viscous_damping": 2e4}, supply={"model": "constant"})
    assert dict(brief(check_rig(rig), rig))["verdict"] == "it works"


def test_the_values_that_a_file_leaves_open_are_told():
    rig = PlantParameters()
    values = {"cylinder": rig.model_dump()["cylinder"], "valve": {"rated_flow": 1e-4}}
    groups = dict(assumed(values, rig))
    assert "cylinder" not in groups
    assert "rated_pressure_drop = 7e+06" in groups["valve"]
    assert not any(entry.startswith("rated_flow") for entry in groups["valve"])
    assert "mass = 60" in groups["load"]


def test_the_console_fits_80_columns(tmp_path):
    answer = hydro_process("check-rig", "--rig", "symmetric_eha", COLUMNS="80")
    assert answer.returncode == 0
    lines = answer.stdout.splitlines()
    assert max(map(len, lines[1:])) <= 80
    assert any(line.startswith("verdict") for line in lines[:12])
    assert "Not in the file, taken from the paper's rig (SI units):" in lines


def test_the_gain_with_an_overlapped_valve_is_that_beyond_its_dead_band():
    rig = PlantParameters().replace(
        valve={"model": "spool", "overlap": 0.2, "underlap": 0.002}, supply={"model": "constant"}
    )
    straight = beyond_dead_band(rig)
    assert beyond_dead_band(straight) == straight
    # The edges open as before, from where the overlap ends: the same flow at the same way beyond it.
    dead, alive = plant_coefficients(rig), plant_coefficients(straight)
    for way in (0.0, 0.01, 0.3, 0.8):
        opened, _ = edge_openings(0.2 + way, dead)
        same, _ = edge_openings(way, alive)
        assert alive.edge_gain * same == pytest.approx(dead.edge_gain * opened, rel=1e-12)
    rows = check_rig(rig)
    [dead_band] = [row.value for row in rows if row.quantity == "dead band"]
    assert dead_band == pytest.approx(2.0)
    # The flow gain there is 1 / 0.8 of that without an overlap, so that the stable gain is 0.8 times as large.
    limits = [
        next(row.value for row in found if row.quantity == "largest stable gain" and "0.3 l/min" in row.at)
        for found in (rows, check_rig(rig.replace(valve={"overlap": 0.0, "underlap": 0.0016})))
    ]
    assert limits[0] / limits[1] == pytest.approx(0.8, rel=0.02)
    assert "the valve is dead within ±2 V" in dict(brief(rows, rig))["verdict"]


def test_values_that_the_chosen_models_do_not_use_are_not_told():
    rig = PlantParameters().replace(valve={"model": "spool"}, supply={"model": "pump"}, friction={"model": "lugre"})
    told = {entry.split(" = ")[0] for _, entries in assumed({}, rig) for entry in entries}
    assert {"bristle_stiffness", "bristle_damping", "line_volume"} <= told
    assert "coil_inductance" not in told
    told = {entry.split(" = ")[0] for _, entries in assumed({}, PlantParameters()) for entry in entries}
    assert "coil_inductance" in told
    assert not {"bristle_stiffness", "bristle_damping", "line_volume"} & told


RIGS = ("symmetric_eha", "aalborg_svsdp_2017")


@pytest.mark.parametrize("rig", RIGS)
def test_half_of_the_largest_stable_gain_and_the_inverse_speeds(rig):
    task = task_config(None, rig=rig)
    gains = pid_from_figures(task)
    loops = [
        sampled_loop(task.plant, place, task.control_period, task.command_latency)
        for place in places_in_reach(task.plant)
    ]
    assert max(loop.spectral_radius(1.98 * gains.proportional) for loop in loops) < 1.0
    assert max(loop.spectral_radius(2.02 * gains.proportional) for loop in loops) > 1.0
    out, back = speed_limits(task.plant)
    assert gains.feedforward_extending * out == pytest.approx(1.0)
    assert gains.feedforward_retracting * back == pytest.approx(1.0)


@pytest.mark.parametrize("rig", RIGS)
def test_a_study_on_another_rig_begins_with_gains_that_are_stable_there(rig):
    study = default_study(Path("own_rig_quick"), rig=rig)
    settings = PIDGains(**study.controllers["PID"].settings)
    given, own = settings.proportional, pid_from_figures(study.task).proportional
    begins = stable_start(study.task, settings).proportional
    assert begins == (own if given > 2.0 * own else given)
    assert begins <= 2.0 * own
