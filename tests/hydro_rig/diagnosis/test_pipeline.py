"""One way to the verdict: what makes ``hydro diagnose`` refuse makes ``trend`` and ``leak-test`` refuse as well."""

import numpy as np
import pandas as pd
import pytest
from command_line import hydro, own_lines
from recorded import CONFIG, recorded_file

from hydro_agents.detection.detector import Reading, Why
from hydro_env import ConfigurationError
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.units import LITRE_PER_MINUTE
from hydro_rig.diagnosis import diagnose as diagnosing
from hydro_rig.diagnosis.diagnose import diagnose, diagnosed
from hydro_rig.diagnosis.oil import Oil
from hydro_rig.diagnosis.verdict import EXIT_CODES, Kind
from hydro_rig.recordings.recording import read_recording
from hydro_rig.recordings.sampling import cut

AREA = plant_coefficients(CONFIG.plant).area_a
UNKNOWN = EXIT_CODES[Kind.UNKNOWN]
OTHER_ROD = {"plant": {"cylinder": {"rod_diameter": 0.024}}}  # than the rig's 28 mm


def moves(leak=1.0, period=CONFIG.control_period):
    """A recording of 24 s of moves, with the flow into chamber a; no window holds all commands."""
    noise = np.random.default_rng(0)
    count = round(3.0 / period)
    speed = np.repeat([sign * size for size in (0.02, 0.05, 0.08, 0.1) for sign in (1.0, -1.0)], count)
    load = np.repeat(noise.uniform(-30e5, 30e5, 8), count)
    difference = load + 2e5 * np.sign(speed) + noise.normal(0.0, 1e4, len(speed))
    flow = AREA * speed + leak * LITRE_PER_MINUTE / 100e5 * difference
    return pd.DataFrame(
        {
            "time [s]": period * np.arange(len(speed)),
            "command [V]": np.where(
                np.arange(len(speed)) % 400 < 5, np.nan, 2.0 * np.sin(np.arange(len(speed)) / 40.0)
            ),
            "position [mm]": 1e3 * (np.cumsum(speed) * period - 0.15) + noise.normal(0.0, 0.01, len(speed)),
            "pressure_a [bar]": 1e-5 * (35e5 + 0.5 * difference),
            "pressure_b [bar]": 1e-5 * (35e5 - 0.5 * difference),
            "flow [l/min]": flow / LITRE_PER_MINUTE,
        }
    )


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """By name: as it should be, and with columns in other units than their headings say."""
    folder, table = tmp_path_factory.mktemp("moves"), moves()
    pressures = ["pressure_a [bar]", "pressure_b [bar]"]
    tables = {
        "right": table,
        "kPa as bar": table.assign(**{name: 100.0 * table[name] for name in pressures}),
        "bar as kPa": table.assign(**{name: 0.01 * table[name] for name in pressures}),
        "gal/min as l/min": table.assign(**{"flow [l/min]": table["flow [l/min]"] / 3.785}),
    }
    for name, one in tables.items():
        one.to_csv(folder / f"{name.replace('/', ' per ')}.csv", index=False)
    return {name: folder / f"{name.replace('/', ' per ')}.csv" for name in tables}


def answer_of(command, file, folder):
    """Exit code and reason of a command."""
    if command == "trend":
        answer = hydro("trend", file, "--append", folder / "trend.csv")
        return answer.returncode, pd.read_csv(folder / "trend.csv", comment="#")["reason"].iloc[0]
    answer = hydro(command, file, "--output", folder / "out")
    return answer.returncode, own_lines(answer.stdout)[-1]


WORDS = {
    "right": "by a balance of volumes over 8 steady moves",
    "kPa as bar": "kPa instead of bar would fit",
    "bar as kPa": "pressures read at most",
    "gal/min as l/min": "flow fits a piston of 3.32 cm² in chamber a, but the rig has 12.6 cm²",
}


@pytest.mark.parametrize(
    ("command", "case"),
    [
        *(("diagnose", "right"), ("trend", "right"), ("leak-test", "right")),
        *(("trend", "kPa as bar"), ("leak-test", "bar as kPa"), ("diagnose", "gal/min as l/min")),
    ],
)
def test_a_measured_flow_decides_alike_everywhere(recordings, tmp_path, command, case):
    found, reason = answer_of(command, recordings[case], tmp_path)
    assert WORDS[case] in reason
    assert found == (EXIT_CODES[Kind.LEAK] if case == "right" else UNKNOWN)


# A rig that the model does not describe ------------------------------------------------------------------------------


def test_another_rig_ends_in_cannot_tell_after_the_first_windows(tmp_path):
    recorded_file(tmp_path / "a.csv", OTHER_ROD, leakage=1.0, duration=1.5)
    answer = hydro("diagnose", tmp_path / "a.csv", "--window", 0.5, "--output", tmp_path / "out")
    assert answer.returncode == UNKNOWN, answer.stderr
    assert own_lines(answer.stdout)[-1].startswith("cannot tell: the model does not describe this rig")
    remarks = pd.read_csv(tmp_path / "out" / "leak.csv")["remark"].tolist()
    assert remarks.count(Why.MISFIT.word) == 2
    assert remarks.count(Why.NOT_READ.word) == 1


@pytest.mark.parametrize("error", [ConfigurationError("pressure_a: 1 bar"), np.linalg.LinAlgError("Singular\nmatrix")])
def test_a_failure_inside_a_reading_is_one_line(recordings, monkeypatch, error):
    def fails(*_, **__):
        raise error

    monkeypatch.setattr(diagnosing, "read_windows", fails)
    verdict = diagnose(recordings["gal/min as l/min"], CONFIG).verdict
    assert verdict.kind is Kind.UNKNOWN
    assert verdict.why.startswith("windows cannot be read: ")
    assert str(error).split("\n")[0] in verdict.line()
    assert "\n" not in verdict.line()


def test_a_leak_has_the_oil_temperature_of_the_windows_that_were_read(tmp_path):
    recorded_file(tmp_path / "axis.csv", leakage=0.3, duration=8.0)
    rows = pd.read_csv(tmp_path / "axis.csv", comment="#")
    rows["oil_temperature [°C]"] = np.where(rows["time [s]"] < 4.0, 20.0, 60.0)
    rows.to_csv(tmp_path / "axis.csv", index=False)
    recording, oil = read_recording(tmp_path / "axis.csv"), Oil.of("46")

    def factor_of(first):
        def choose(samples):
            return cut(samples, round(2.0 / samples.period)).part(np.arange(2) + first)

        def read(windows, config):
            del config
            size = np.full(len(windows), 0.3)
            known = {"probability": 1.0, "flow_lpm": size, "low_lpm": 0.9 * size, "high_lpm": 1.1 * size}
            return Reading.of(size, **known), None

        return diagnosed(recording, CONFIG, choose, read, oil).reading.flow_lpm[0] / 0.3

    assert [factor_of(0), factor_of(2)] == pytest.approx(oil.factor([20.0, 60.0]))
