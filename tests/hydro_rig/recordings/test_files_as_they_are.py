"""One simulated recording as other programs write it: each file holds the same signals."""

import gzip

import numpy as np
import pandas as pd
import pytest
import scipy.io
from optional_libraries import library
from recorded import CONFIG, changed, recorded_file
from refusal import refused

from hydro_rig.recordings.columns import read_map
from hydro_rig.recordings.quality import check_recording
from hydro_rig.recordings.recording import read_recording

BEGIN = pd.Timestamp("2026-03-10 08:00:00")
NAMES = ["position", "pressure_a", "pressure_b", "spool_position", "command"]
UNITS = ["mm", "bar", "bar", "%", "V"]


def map_of(time, columns=NAMES, units=UNITS):
    signals = zip(NAMES, columns, units, strict=True)
    lines = [f"{name}: {{column: {column!r}, unit: '{unit}'}}" for name, column, unit in signals]
    return "\n".join([f"time: {time}", *lines])


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """A simulated recording, its table, and the text of its file."""
    path = tmp_path_factory.mktemp("original") / "axis.csv"
    recorded_file(path, duration=1.5)
    return read_recording(path), pd.read_csv(path, comment="#"), path.read_text(encoding="utf-8")


def stamped(table, kind):
    """The table with dates and times, three digits of a second."""
    stamps = BEGIN + pd.to_timedelta(table["time [s]"], unit="s")
    return table.assign(**{"time [s]": stamps.dt.strftime(kind).str.replace(r"(\.\d{3})\d{3}", r"\1", regex=True)})


def of_powershell(table, text, path):
    path.write_text(text, encoding="utf-16")
    return map_of("time", range(2, 7))


def packed_by_gzip(table, text, path):
    path.write_bytes(gzip.compress(text.encode()))


def of_pi(table, text, path):
    stamped(table, "%d-%b-%Y %H:%M:%S.%f").to_csv(path, index=False)


def of_pi_with_short_years(table, text, path):
    stamped(table, "%d-%b-%y %H:%M:%S.%f").to_csv(path, index=False)


def american(table, text, path):
    stamped(table, "%m/%d/%Y %I:%M:%S.%f %p").to_csv(path, index=False)


def british(table, text, path):
    """On the 13th, which cannot be a month."""
    table = table.assign(**{"time [s]": table["time [s]"] + 3 * 86400.0})
    stamped(table, "%d/%m/%Y %H:%M:%S.%f").to_csv(path, index=False)


def iso_with_a_comma(table, text, path):
    table = stamped(table, "%Y-%m-%d %H:%M:%S.%f")
    table["time [s]"] = table["time [s]"].str.replace(".", ",")
    table.to_csv(path, sep=";", index=False)


def date_and_time_in_two_columns(table, text, path):
    both = stamped(table, "%d.%m.%Y %H:%M:%S.%f")["time [s]"].str.split(" ", expand=True)
    table = table.assign(**{"time [s]": both[1]})
    table.insert(0, "Date", both[0])
    table.to_csv(path, index=False)


def days_of_excel(table, text, path):
    days = (BEGIN - pd.Timestamp("1899-12-30")) / pd.Timedelta(days=1) + table["time [s]"] / 86400.0
    table.assign(**{"time [s]": days.map("{:.10f}".format)}).to_csv(path, index=False)
    return map_of("{column: 'time [s]', unit: d}", range(2, 7))


def with_thousands(table, text, path):
    table = table.rename(columns=lambda name: name.replace("bar", "kPa"))
    for name in ("pressure_a [kPa]", "pressure_b [kPa]"):
        table[name] = [f"{value:,.4f}" for value in 100.0 * table[name]]
    table.to_csv(path, sep=";", index=False)


def with_german_thousands(table, text, path):
    with_thousands(table, text, path)
    path.write_text(path.read_text().translate(str.maketrans(".,", ",.")))


def with_quoted_thousands(table, text, path):
    with_thousands(table, text, path)
    pd.read_csv(path, sep=";", dtype=str).to_csv(path, index=False)


def rows_of_tags(table, bad, good):
    """A row per reading, interleaved as historians do it, and one of bad quality per tag."""
    rows = stamped(table, "%d-%b-%Y %H:%M:%S.%f").melt("time [s]", var_name="Tag", value_name="Value")
    rows = rows.rename(columns={"time [s]": "Timestamp"}).sort_values("Timestamp", kind="stable")
    rows["Tag"] = "AX1." + rows["Tag"].str.partition(" ")[0]
    rows["Status"] = good
    rows.iloc[35:40] = rows.iloc[35:40].assign(Value=-999.0, Status=bad)
    return rows[["Tag", "Timestamp", "Value", "Status"]]


def rows_of_pi(table, text, path):
    rows_of_tags(table, "Bad", "Good").to_csv(path, index=False)
    return map_of("Timestamp", [f"AX1.{name}" for name in NAMES])


def rows_of_wincc(table, text, path):
    rows = rows_of_tags(table, 0, 1).set_axis(["VarName", "TimeString", "VarValue", "Validity"], axis=1)
    rows["TimeString"] = pd.to_datetime(rows["TimeString"]).dt.strftime("%d.%m.%Y %H:%M:%S.%f")
    rows.to_csv(path, sep=";", decimal=",", index=False)
    return map_of("TimeString", [f"AX1.{name}" for name in NAMES])


def of_daqami(table, text, path):
    lines = ["Device: USB-1608FS", "Serial Number: 2060DB1", "Channel Count: 5", f"Sample Count: {len(table)}"]
    lines += ["Start Time: 3/10/2026 8:00:00 AM", "Scan Rate: 200"]
    heads = ["Sample", "Date/Time", *(f"{name} ({unit})" for name, unit in zip(NAMES, UNITS, strict=True))]
    rows = stamped(table, "%-m/%d/%Y %-I:%M:%S.%f %p").astype(str).to_numpy()
    lines += ['","'.join(heads), *('","'.join([str(number), *row]) for number, row in enumerate(rows))]
    path.write_text("".join(f'"{line}"\r\n' for line in lines), encoding="utf-8-sig")
    return "\n".join(["time: Date/Time", *(f"{name}: {name}" for name in NAMES)])


def of_labview(table, text, path):
    count = len(NAMES)
    head = ["LabVIEW Measurement\t", "Writer_Version\t2", "Separator\tTab", "X_Columns\tOne", "Time_Pref\tRelative"]
    head += ["Date\t2026/03/10", "Time\t08:00:00.0000000", "***End_of_Header***\t", "\t"]
    head += [f"Channels\t{count}" + count * "\t"]
    for name, value in (("Samples", "300"), ("Date", "2026/03/10"), ("Time", "08:00:00"), ("X_Dimension", "Time")):
        head.append("\t".join([name, *[value] * count, ""]))
    head += ["\t".join(["Y_Unit_Label", *UNITS, ""]), "\t".join(["Delta_X", *["0.005"] * count, ""])]
    head += [f"***End_of_Header***{count * chr(9)}\t", "\t".join(["X_Value", *NAMES, "Comment"])]
    rows = ["\t".join(f"{value:.9f}" for value in row) for row in table.to_numpy()]
    rows[0] += "\tbegun by hand"
    path.write_text("\r\n".join(head + rows))
    return map_of("X_Value")


def of_labview_without_stamps(table, text, path):
    of_labview(table.rename(columns={"time [s]": ""}), text, path)
    head, mark, rows = path.read_text().rpartition("Comment")
    lines = rows.splitlines()
    path.write_text(head + mark + "\n".join("\t" * ("\t" in line) + line.partition("\t")[2] for line in lines))
    return map_of("{column: X_Value, equidistant: 5 ms}")


def of_to_file(table, text, path):
    scipy.io.savemat(path, {"ans": table.to_numpy().T})
    return map_of("time", [f"ans.{number}" for number in range(1, 6)])


def of_to_workspace(table, text, path):
    scipy.io.savemat(path, {"tout": table.to_numpy()[:, :1], "simout": table.to_numpy()[:, 1:]})
    return map_of("tout", [f"simout.{number}" for number in range(1, 6)])


def of_to_workspace_with_time(table, text, path):
    signals = {"values": table.to_numpy()[:, 1:], "dimensions": 5.0, "label": ""}
    scipy.io.savemat(path, {"simout": {"time": table.to_numpy()[:, 0], "signals": signals, "blockName": "m/Out"}})
    return map_of("time", [f"simout.{number}" for number in range(1, 6)])


def with_an_unnamed_index(table, text, path):
    library("pyarrow")
    dates = BEGIN + pd.to_timedelta(table["time [s]"], unit="s")
    table.drop(columns="time [s]").set_axis(pd.DatetimeIndex(dates.array), axis=0).to_parquet(path)


def with_a_prelude(table, text, path):
    """Longer than its rows are wide, with a line of names, one of sensors and one of units."""
    kinds = ["Sensor", "LVDT", "DMS", "DMS", "LVDT", "AO"]
    prelude = [f"Channel {number};12,5;;;;" for number in range(120)] + ["Rig;hall 3;bay;a;b;c", ";".join(kinds)]
    rows = table.to_csv(sep=";", index=False, header=False)
    path.write_text("\n".join([*prelude, ";".join(["time", *NAMES]), ";".join(["s", *UNITS]), rows]))


FILES = {
    "powershell.csv": of_powershell,
    "gzip.csv.gz": packed_by_gzip,
    "pi.csv": of_pi,
    "pi_short.csv": of_pi_with_short_years,
    "american.csv": american,
    "british.csv": british,
    "comma.csv": iso_with_a_comma,
    "two_columns.csv": date_and_time_in_two_columns,
    "excel.csv": days_of_excel,
    "thousands.csv": with_thousands,
    "thousands_german.csv": with_german_thousands,
    "thousands_quoted.csv": with_quoted_thousands,
    "long_pi.csv": rows_of_pi,
    "long_wincc.csv": rows_of_wincc,
    "daqami.csv": of_daqami,
    "labview.lvm": of_labview,
    "labview_without_stamps.lvm": of_labview_without_stamps,
    "to_file.mat": of_to_file,
    "to_workspace.mat": of_to_workspace,
    "to_workspace_with_time.mat": of_to_workspace_with_time,
    "index.parquet": with_an_unnamed_index,
    "prelude.csv": with_a_prelude,
}
"""What writes the file, by its name; it returns the map that the file needs."""

SLASHES = "time has dates with slashes; the first is read as "
NOTES = {
    "labview_without_stamps.lvm": ["time is taken as equidistant, one row every 5 ms, as the map says"],
    "american.csv": [SLASHES + "10 March 2026"],
    "british.csv": [SLASHES + "13 March 2026"],
    "daqami.csv": [SLASHES + "10 March 2026"],
}
UNDATED = ("powershell", "gzip", "thousands", "labview", "to_", "prelude")


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_another_program_holds_the_same(tmp_path, original, name):
    simulated, table, text = original
    columns = FILES[name](table.copy(), text, tmp_path / name)
    if columns:
        (tmp_path / "map.yaml").write_text(columns, encoding="utf-16" if "powershell" in name else "utf-8")
        columns = read_map(tmp_path / "map.yaml")
    found = read_recording(tmp_path / name, columns)
    expected = simulated.signals.copy()
    if "long" in name:
        assert sorted(np.argwhere(np.isnan(found.signals))[:, 0]) == [0, 1, 2, 3, 4]
        expected[:, 7] = np.nan
    np.testing.assert_allclose(found.time, simulated.time, atol=1e-5 if name == "excel.csv" else 1e-6)
    np.testing.assert_allclose(found.signals, expected, rtol=1e-6, atol=1e-9)
    days = 3.0 if name == "british.csv" else 0.0
    dated = 0.0 if name.startswith(UNDATED) else BEGIN.timestamp() + 86400.0 * days
    assert found.begin == pytest.approx(dated, abs=1e-4)
    assert [finding.line() for finding in found.findings] == NOTES.get(name, [])


def test_what_stays_out_is_told_in_one_line_with_its_conversion(tmp_path, original):
    _, table, text = original
    (tmp_path / "b.csv.gz").write_bytes(gzip.compress(text.encode())[:200])
    with refused("is not a readable"):
        read_recording(tmp_path / "b.csv.gz")
    with refused("cannot be read: No such file"):
        read_recording(tmp_path / "none.csv.gz")
    for kind in ("xlsx", "mf4", "tdms"):
        (tmp_path / f"a.{kind}").touch()
        with refused(r"convert the file first: .*to_parquet"):
            read_recording(tmp_path / f"a.{kind}")
    (tmp_path / "a.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400))
    with refused(r"v7.3.*in MATLAB: save\('run.mat', '-v7'\)"):
        read_recording(tmp_path / "a.mat")
    rows_of_tags(table, "Bad", "Stale").to_csv(tmp_path / "a.csv", index=False)
    with refused("a.csv: is not .*: no reading is good: 'Status' holds 'stale'"):
        read_recording(tmp_path / "a.csv")
    table.rename(columns=lambda heading: heading.replace("bar", "mA")).to_csv(tmp_path / "b.csv", index=False)
    with refused(r"'pressure_a \[mA\]' is a current; give unit, gain and offset in the map.*4 to 20 mA"):
        read_recording(tmp_path / "b.csv")


def test_a_raw_current_is_named_with_its_gain_and_offset(original):
    recording = original[0]
    signals = recording.signals.copy()
    signals[1:3] = 1e5 * (4.0 + 16.0 * signals[1:3] / CONFIG.sensors.pressure_a.high)
    told = [finding.line() for finding in check_recording(changed(recording, signals=signals), CONFIG).findings]
    wanted = "raw signals of 4 to 20 mA would fit: for sensors of 0 bar to 100 bar write gain: 6.25, offset: -25 in"
    assert any(wanted in line for line in told), told
