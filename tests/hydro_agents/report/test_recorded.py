"""What all pages of a recording share: each signal in its own row, the model over it, marks, and facts."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from hydro_agents.report.recorded import Line, Mark, Signal, paint_course, recording_tables
from hydro_env import PlantParameters


def test_each_row_shows_its_lines_the_model_and_its_marks():
    time = np.r_[0.0:1.0:0.01, 2.0:3.0:0.01]  # a second is missing
    position = Signal("position, mm", {"position": Line(time, time)}, [Line(time[:50], 2.0 * time[:50])] * 2)
    pressures = {"a": Line(time, 10.0 + time), "b": Line(time, 20.0 + time)}
    panels = Figure().subplots(2, 1, sharex=True)
    paint_course(panels, [position, Signal("pressure, bar", pressures, marks=[Mark(0.5, 0.7, "jumps")])])
    assert [axes.get_ylabel() for axes in panels] == ["position, mm", "pressure, bar"]
    measured, model, _ = (line.get_ydata() for line in panels[0].lines)
    assert np.isnan(measured).sum() == 1  # the line breaks
    np.testing.assert_array_equal(model, 2.0 * time[:50])
    assert [np.nanmin(line.get_ydata()) for line in panels[1].lines] == [10.0, 20.0]
    assert [text.get_text() for text in panels[0].get_legend().get_texts()] == ["position", "simulated"]
    assert [text.get_text() for text in panels[1].texts] == ["jumps"]
    assert panels[1].patches[0].get_extents().transformed(panels[1].transData.inverted()).x0 == pytest.approx(0.5)


def test_facts_say_the_rig_and_the_length():
    tables = recording_tables("a.csv", PlantParameters(), np.array([0.0, 1.5, 3.0]), [], Control_period="5 ms")
    facts = tables["protocol"].set_index("key")["value"].to_dict()
    assert facts["Rig assumed"] == "bore 40 mm, rod 28 mm, stroke 400 mm, supply 70 bar"
    assert (facts["Recording"], facts["Duration"]) == ("a.csv", "3.00 s, 3 rows")
    assert facts["Control period"] == "5 ms"
    assert tables["findings"].empty
