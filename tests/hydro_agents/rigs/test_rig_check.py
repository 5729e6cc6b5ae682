"""``hydro check-rig``: the figures are the known ones, wrong rigs get one line."""

import cmath
import math
import re
from unittest import mock

import numpy as np
import pytest
from command_line import ROOT, assert_one_clear_line, hydro

from hydro_agents.commands.options import check_new_file
from hydro_agents.controllers.sampled_loop import places_in_reach, sampled_loop
from hydro_agents.learning import stable_gain
from hydro_agents.learning.stable_gain import (
    QuietGains,
    beyond_dead_band,
    leaking,
    loops_over_reach,
    loops_within_ranges,
    weakest,
)
from hydro_agents.rigs.check import check_rig, resting_place
from hydro_agents.rigs.check_page import bode_frequencies, check_page
from hydro_agents.rigs.check_table import brief, implausible
from hydro_agents.rigs.rig_file import answers_from, new_rig
from hydro_env import ConfigurationError, HydroError, PlantParameters, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.plant.arrays import equilibrium, plant_coefficients
from hydro_env.plant.linearisation import linearise
from hydro_env.plant.parts.valve import edge_openings
from hydro_env.task.configuration import task_config
from hydro_env.task.rig import read_rig

FEW = mock.patch.multiple(stable_gain, DRAWN=6, PLANTS=3)
"""Few drawn plants, where a test does not ask for the worst of many."""

with FEW:
    ROWS = check_rig(PlantParameters())


@pytest.fixture
def few():
    with FEW:
        yield


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


def test_leakage_damps_adds_margin_and_softens():
    def over_leaks(quantity, at):
        return [figure(quantity, at.format(leak)) for leak in ("0.01", "0.3", "1", "4")]

    for quantity in ("damping ratio, linearised", "largest stable gain (5 ms, 1 ms late)"):
        values = over_leaks(quantity, "mid-stroke, {} l/min")
        assert values == sorted(values)
    stiffness = over_leaks("static stiffness", "recommended gain, mid-stroke, {} l/min")
    assert stiffness == sorted(stiffness, reverse=True)


def rows_of(**changes):
    rig = PlantParameters().replace(**changes)
    rows = check_rig(rig, task=TaskConfig(plant=rig, randomisation={}))
    return {(row.quantity, row.at): row.value for row in rows}


CIRCUITS = {
    "pump standing": {"supply": {"pump_flow": 0.0}},
    "line alone": {"supply": {"model": "pump", "pump_flow": 0.0, "relief_slope": 0.0}},
    "lugre, ideal valve": {"friction": {"model": "lugre"}, "valve": {"model": "ideal"}},
    "constant supply, no spring, no leak": {
        "supply": {"model": "constant"},
        "load": {"spring_stiffness": 0.0},
        "leakage": {"internal_resistance": math.inf},
    },
}


@pytest.mark.parametrize("changes", CIRCUITS.values(), ids=CIRCUITS)
def test_every_circuit_is_checked(changes):
    rows = rows_of(**changes)
    numbers = [value for value in rows.values() if not isinstance(value, str)]
    assert all(math.isfinite(value) for value in numbers)
    pump = rows.get(("flow of the pump", ""))
    supply = PlantParameters().replace(**changes).supply
    assert pump == (None if supply.model == "constant" else pytest.approx(supply.pump_flow * 6e4))


def test_the_command_prints_figures_and_warnings(tmp_path, few):
    (tmp_path / "odd.yaml").write_text("valve: {rated_flow: 0.02}")
    for rig in (ROOT / "configs" / "rigs" / "kovari_2015.yaml", tmp_path / "odd.yaml"):
        result = hydro("check-rig", "--rig", rig, "--output", tmp_path / "page.html", "--overwrite")
        assert result.returncode == 0, result.stderr
        assert ("stroke = 0.4" in (tmp_path / "page.html").read_text("utf-8")) == (rig.stem == "odd")
        assert rig.name in result.stdout
        assert "largest stable gain" in result.stdout
        warnings = [line for line in result.stdout.splitlines() if line.startswith("warning: ")]
        assert len(warnings) == (rig.stem == "odd")
    for file in (ROOT / "configs" / "rigs").glob("*.yaml"):
        assert not implausible(read_rig(file).plant)


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
    exact = TaskConfig(plant=rig, randomisation={})
    rows = check_rig(rig, task=exact)
    [dead_band] = [row.value for row in rows if row.quantity == "dead band"]
    assert dead_band == pytest.approx(2.0)
    # The flow gain there is 1 / 0.8 of that without an overlap, so that the stable gain is 0.8 times as large.
    plain = task_config(exact, plant={"valve": {"overlap": 0.0, "underlap": 0.0016}})
    limits = [weakest(loops_over_reach(task, task.plant, 0.3)).gain for task in (exact, plain)]
    assert limits[0] / limits[1] == pytest.approx(0.8, rel=0.02)
    assert "the valve is overlapped, dead within ±2 V" in dict(brief(rows, rig))["verdict"]


def test_it_examines_a_place_where_the_rig_can_rest():
    """At mid-stroke the leak of this rig takes more than the valve feeds; where the spring bears the load it rests."""
    rig = PlantParameters().replace(load={"external_force": 5000.0}, leakage={"internal_resistance": 2e10})
    with pytest.raises(HydroError, match="cannot be held"):
        equilibrium(rig, 0.0)
    place = resting_place(rig)
    assert place < 0.0
    equilibrium(rig, place)


def test_the_timing_is_that_of_the_options(few, monkeypatch):
    monkeypatch.setattr("hydro_agents.rigs.check.quiet_gains", mock.Mock(side_effect=HydroError("not asked")))
    rig = "symmetric_eha"
    answer = hydro("check-rig", "--rig", rig, "--period", "1ms", "--latency", "0.5ms")
    assert answer.returncode == 0, answer.stderr
    [row] = re.findall(r"largest stable gain \(1 ms, 0.5 ms late\) +mid-stroke, 0.01 l/min +(\S+)", answer.stdout)
    gain = float(row)
    plant = leaking(read_rig(rig).plant, 0.01)
    expected, usual = (sampled_loop(plant, 0.0, *at).largest_stable_gain() for at in ((1e-3, 0.5e-3), (5e-3, 1e-3)))
    assert gain == pytest.approx(expected, rel=1e-3)
    assert gain != pytest.approx(usual, rel=0.1)


@pytest.mark.parametrize("options", [("--period", "1 bar"), ("--latency", "-1 ms"), ("--latency", "26 ms")])
def test_an_impossible_timing_gets_one_line(options):
    assert_one_clear_line(hydro("check-rig", *options), options[0])


def test_margins_are_those_of_the_loop():
    """A gain larger by the gain margin, or a phase turned by the phase margin, is just stable."""
    task = task_config(None, rig="symmetric_eha")
    found = weakest(loops_over_reach(task, task.plant))
    for gain in (0.2 * found.gain, 0.5 * found.gain, 0.9 * found.gain):
        margin = found.loop.phase_margin(gain)
        assert 0.0 < margin < 180.0
        turned = [gain * cmath.exp(-1j * math.radians(angle)) for angle in (margin - 0.5, margin + 1.0)]
        assert found.loop.spectral_radius(turned[0]) < 1.0 < found.loop.spectral_radius(turned[1])
        # Lag and lead are one: the spectrum of the turned loop is mirrored.
        assert found.loop.spectral_radius(turned[0].conjugate()) == pytest.approx(found.loop.spectral_radius(turned[0]))
    assert found.loop.phase_margin(1.01 * found.gain) == 0.0


def loops_of(plant, task):
    """Loops at five positions of the reach; a plant that cannot be held at one of them has none there."""
    loops = []
    for place in places_in_reach(plant)[::2]:
        try:
            loops.append(sampled_loop(plant, place, task.control_period, task.command_latency))
        except HydroError:
            continue
    return loops


OWN = {"63/45 x 500": ("63 mm", "45 mm", "500 mm", "40 l/min", "160 bar", "200 kg")}
KEYS = ("bore", "rod", "stroke", "rated_flow", "supply_pressure", "mass")


@pytest.mark.parametrize("name", ["kovari_2015", *OWN])
def test_the_recommended_gain_is_stable_on_every_drawn_plant(name, tmp_path):
    """The plants come from the environment's own draws, which the search for the gain does not use."""
    rig = name
    if name in OWN:
        texts = dict(zip(KEYS, OWN[name], strict=True))
        rig = tmp_path / "rig.yaml"
        rig.write_text(new_rig(answers_from(texts), "rig.yaml")[0], encoding="utf-8")
    task = task_config(None, rig=rig)
    nominal, worst = weakest(loops_over_reach(task, task.plant)), weakest(loops_within_ranges(task))
    assert worst.gain < nominal.gain
    envs = ServoHydraulicVectorEnv(60, task)
    envs.reset(seed=4711)
    plants = [beyond_dead_band(leaking(envs.axes.parameters(number), 0.01)) for number in range(60)]
    loops = [loop for plant in plants for loop in loops_of(plant, task)]
    assert len(loops) > 240
    assert all(loop.is_stable(0.5 * worst.gain) for loop in loops)
    if name in OWN:  # where the file's own values alone mislead
        assert not all(loop.is_stable(0.5 * nominal.gain) for loop in loops)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"load": {"tip_share": 0.7, "tip_frequency": 2.0 * math.pi * 6.0, "mass": 1700.0}}, "second mass"),
        ({"lines": {"length_a": 6.0, "length_b": 6.0, "volume_a": 5e-4, "volume_b": 5e-4}}, "lines"),
    ],
    ids=["boom", "waves"],
)
def test_a_rig_with_structure_tells_its_resonances(changes, what, few, monkeypatch):
    """Those of the linearisation; the warning begins where the sampled loop without friction becomes unstable."""
    rig = PlantParameters().replace(**changes)
    task = TaskConfig(plant=rig, randomisation={})
    healthy = stable_gain.leaking(rig, stable_gain.HEALTHY_LEAK)
    modes = linearise(healthy.replace(friction={"model": "none"})).modes
    loop = sampled_loop(stable_gain.beyond_dead_band(healthy), 0.0, task.control_period, task.command_latency)
    for share, excited in ((0.95, False), (1.05, True)):
        gain = share * loop.largest_stable_gain() / stable_gain.SHARE_OF_STABLE
        monkeypatch.setattr("hydro_agents.rigs.check.quiet_gains", lambda _, gain=gain: QuietGains(gain, gain))
        rows = check_rig(rig, task=task)
        figures = {row.key: row for row in rows if row.key}
        found = [figures[f"resonance {number}"].value for number in range(1, len(modes) + 1)]
        assert found == pytest.approx([mode.natural_frequency / (2.0 * math.pi) for mode in modes])
        assert any(what in row.quantity for row in rows if row.group == "resonances")
        lines = dict(brief(rows, rig))
        assert f"{found[0]:.3g} Hz" in lines["resonances"]
        damping = [figures[f"resonance {number} with gain"].value for number in range(1, len(modes) + 1)]
        assert (min(damping) < 0.0) == excited
        worst = found[int(np.argmin(damping))]
        assert (f"the recommended gain excites the resonance at {worst:.3g} Hz" in lines["verdict"]) == excited


def test_the_page_holds_the_figures_and_the_plots(few, tmp_path):
    task = TaskConfig()
    page = check_page("axis", brief(ROWS, task.plant), ["supply.pressure: bar meant?"], ROWS, task).html()
    assert page.count("<figure") == 2
    assert "supply.pressure: bar meant?" in page
    assert page.count("At mid-stroke, sampled every 5 ms, command 1 ms late.") == 2
    assert all(name in page for name in ("12.57", "recommended gain", "frequency, Hz", "4 l/min"))
    assert_one_clear_line(hydro("check-rig", "--output", tmp_path), "is a folder")
    inside_a_file = tmp_path / "file" / "page.html"
    inside_a_file.parent.touch()
    with pytest.raises(ConfigurationError, match="cannot be written"):
        check_new_file(inside_a_file, overwrite=False)


def test_a_rig_without_a_quiet_gain_says_why(monkeypatch):
    """In the verdict, and on the page in place of the plots."""
    monkeypatch.setattr("hydro_agents.rigs.check.quiet_gains", mock.Mock(side_effect=HydroError("it never rests")))
    task = TaskConfig(randomisation={})
    rows = check_rig(task.plant, task=task)
    said = brief(rows, task.plant)
    assert "it never rests" in dict(said)["verdict"]
    assert "it works" not in dict(said)["verdict"]
    page = check_page("axis", said, [], rows, task).html()
    assert "No plots: it never rests" in page
    assert "<figure" not in page


def test_a_bode_plot_follows_a_sharp_resonance():
    tip = {"tip_share": 0.4, "tip_frequency": 2.0 * math.pi * 8.0, "tip_damping_ratio": 0.0005, "spring_stiffness": 0.0}
    plant = PlantParameters().replace(load=tip, supply={"model": "constant"})
    loop = sampled_loop(beyond_dead_band(leaking(plant, 0.01)))
    [mode] = [mode for mode in linearise(plant.replace(friction={"model": "none"})).modes if "tip" in mode.state]
    centre = mode.natural_frequency / (2.0 * math.pi)
    near, drawn_at = np.linspace(0.97 * centre, 1.03 * centre, 20_001), bode_frequencies(loop)
    known, drawn = (20.0 * np.log10(np.abs(loop.frequency_response(at))) for at in (near, drawn_at))
    assert np.interp(near, drawn_at, drawn) == pytest.approx(known, abs=2.0)  # dB
