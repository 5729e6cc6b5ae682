"""The report: one self-contained, well-formed page whose sentences say what the tables say."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from xml.etree import ElementTree

import markupsafe
import matplotlib
import numpy as np
import pandas as pd
import pytest
from browser import open_page, problems_everywhere
from contrast import contrast
from published import assert_published_page
from refusal import refused
from untrained import untrained_head

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.evaluation.comparison import Grid
from hydro_agents.evaluation.evaluate import Evaluation, ProtocolSettings, evaluate, growth_of
from hydro_agents.report.content import interval_text, verdict
from hydro_agents.report.palette import LEAK_LOOKS, LEAKS, NEUTRALS, SERIES, VARIABLES, looks_of
from hydro_agents.report.sections import Text, render_page
from hydro_agents.report.shared import corrected_table, findings_of
from hydro_agents.report.study import STUDY, Example, content_of, growth_table, overview, tables_of, warnings_of
from hydro_agents.report.study_detection import detection
from hydro_agents.report.training_plots import learning_plots
from hydro_agents.running.statistics import Interval
from hydro_agents.running.text import correction_name, duration, number
from hydro_agents.study.results import write_tables
from hydro_env import TaskConfig

CONFIG = TaskConfig(episode_duration=0.4)
SETTINGS = ProtocolSettings(plants=3, leak_levels=(0.01, 4.0), families=("step", "sine"), detection_episodes=120)
ODD_NAME = 'PPO <b>&"quoted"'
FACTS = {"command": "hydro study --seed 3", "seed": 3, "machine": "a box with 2 cores", "numpy": "9.9.9"}
KEYS = (
    "level-mean_error_mm-mean", "level-valve_travel_per_s-mean", "level-reversals_per_s-mean", "family",
    "ratio", "level-mean_error_mm-worst", "run-0", "level-supply_energy_j-mean",
    "rates", "learning",
)  # fmt: skip
DRAWING = re.compile(r'<svg[^>]*role="img".*?</svg>', flags=re.DOTALL)
ERROR, BASE_ERROR = "validation/mean_error_mm", "validation/base_mean_error_mm"


def rendered(evaluation, examples=(), curve=True, **others):
    """The page of an evaluation with made-up facts; ``others`` are parts of its content."""
    steps = np.arange(0.0, 5000.0, 100.0)
    error = np.where(steps > 0.0, 0.3 + np.exp(-steps / 1000), np.nan)
    tables = {}
    if curve:
        tables["training_curve"] = pd.DataFrame({"time/total_timesteps": steps, "seconds": steps / 100, ERROR: error})
    others = {"configuration": "task:\n  control_period: 0.005 # <&>\n", "examples": list(examples), **others}
    others = {"timings": {"train PPO": 3725.0, "evaluate": 1.25}, "validation_error_mm": 0.5, **others}
    return render_page("Trial <one>", STUDY, content_of(evaluation, FACTS, tables, **others))


def example(names, **changes):
    time = np.linspace(0.005, 0.4, 80)
    traces = {name: 0.01 * (1.0 - np.exp(-time / 0.05)) for name in names}
    command = dict.fromkeys(names, 0.1 * time)
    return replace(Example("the same with 4 l/min", time, np.full(80, 0.01), traces, command, leak=4.0), **changes)


@pytest.fixture(scope="module")
def evaluation():
    gains = {"PID": 200.0, ODD_NAME: 60.0}
    controllers = {name: PID(PIDGains(proportional=gain), CONFIG) for name, gain in gains.items()}
    return evaluate(CONFIG, controllers, untrained_head(CONFIG), SETTINGS)


@pytest.fixture(scope="module")
def page(evaluation):
    return rendered(evaluation, [example(evaluation.controllers)]).html


class Page(HTMLParser):
    """Checks that tags are closed in order, and collects what stands in the page."""

    def __init__(self, text):
        super().__init__()
        self.open, self.attributes, self.words = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.attributes.append((tag, dict(attrs)))
        if tag not in {"meta", "br", "input"}:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.attributes.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.words))  # unbroken spaces become plain ones

    def all(self, tag):
        return [attributes for name, attributes in self.attributes if name == tag]


def test_the_page_stands_alone(page):
    found = Page(page)
    assert len(page) < 3_000_000
    files = {f"figures/{key}.svg" for key in KEYS}
    assert {a["href"] for a in found.all("a") if "download" in a} == files
    for tag, attributes in found.attributes:
        assert tag not in ("link", "img", "iframe", "object", "base", "form")
        assert not attributes.keys() & {"src", "srcset", "action", "background", "onload"}
        for name in ("href", "xlink:href"):
            assert attributes.get(name, "#").startswith("#") or attributes["href"] in files
    assert "@import" not in page
    assert set(re.findall(r"https?://[^\"' ]*", page)) <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    ids = [attributes["id"] for _, attributes in found.attributes if "id" in attributes]
    targets = re.findall(r'(?:href="#|url\(#)([^")]+)', page)
    assert len(ids) == len(set(ids))
    assert len(targets) > 100
    assert set(targets) <= set(ids)
    assert set(re.findall(r"url\((.)", page)) <= {"#"}


def test_figures_and_tables_speak_to_everyone(page):
    found, drawings = Page(page), DRAWING.findall(page)
    assert len(drawings) == len(found.all("figcaption")) == len(KEYS)
    for root in map(ElementTree.fromstring, drawings):
        assert len(root.get("aria-label")) > 30
        assert root.get("width") is None  # as wide as the page
    assert len(found.all("caption")) == len(found.all("table")) == 9
    assert not re.search(r"#[0-9a-f]{6}\b", "".join(drawings))  # every colour follows the theme


def test_the_page_tells_how_it_was_made_and_escapes_names(page):
    found = Page(page)
    for wanted in (
        *FACTS.values(), "1 h 2 min", "1.2 s", "simulated", ODD_NAME, "control_period: 0.005 # <&>",
        "2000000", "steps, sines", "3 plants per leak size and kind of reference are too few for a decision",
    ):  # fmt: skip
        assert str(wanted) in found.text
    assert "<b>" not in page
    assert "<one>" not in page
    assert any(ODD_NAME in attributes.get("aria-label", "") for attributes in found.all("svg"))
    assert "outside the test seeds" not in found.text


def test_warnings_stand_above_a_small_run_and_above_seeds_of_the_training(evaluation):
    cases = evaluation.cases
    few, outside = warnings_of(content_of(replace(evaluation, cases=cases.assign(seed=cases["seed"] - 2_000_000))))
    assert "3 plants" in few
    assert "may have been trained on them" in outside
    many = pd.concat([cases.assign(plant=cases["plant"] + 3 * i) for i in range(8)])
    assert warnings_of(content_of(replace(evaluation, cases=many))) == []


def test_the_same_numbers_give_the_same_bytes(evaluation, page, tmp_path):
    matplotlib.rcParams["xtick.direction"] = "in"  # a user's own settings
    try:
        again = rendered(evaluation, [example(evaluation.controllers)])
        assert matplotlib.rcParams["xtick.direction"] == "in"
    finally:
        matplotlib.rcdefaults()
    again.write(tmp_path / "deep" / "report.html")
    assert (tmp_path / "deep" / "report.html").read_bytes() == page.encode()
    assert sorted(path.name for path in (tmp_path / "deep").iterdir()) == ["figures", "report.html"]
    assert sorted(path.stem for path in (tmp_path / "deep" / "figures").iterdir()) == sorted(KEYS)
    drawing = ElementTree.parse(tmp_path / "deep" / "figures" / "ratio.svg").getroot()  # whole by itself
    assert drawing.get("width") == "331.2pt"
    (tmp_path / "file").write_text("")
    with refused("cannot be written"):
        again.write(tmp_path / "file" / "report.html")


def test_one_controller_without_a_head(tmp_path):
    alone = {"leak_levels": (0.3,), "families": ("step",), "plants": 2}
    settings = SETTINGS.model_copy(update=alone)
    lonely = evaluate(CONFIG, {"PID": PID(PIDGains(), CONFIG)}, None, settings)
    text = Page(rendered(lonely, curve=False, timings={}).html).text
    assert "missing or rough" in text
    for absent in ("Detecting the leak", "Ratio of errors", "nan", "AUROC"):
        assert absent not in text
    names = [path.name for path in write_tables(tmp_path / "tables", tables_of(lonely))]
    assert names == [f"{name}.csv" for name in ("cases", "levels", "families", "limit_cycles", "limit_cycle_summary")]


def test_tables_hold_all_numbers(evaluation, tmp_path):
    paths = write_tables(tmp_path, tables_of(evaluation))
    assert [path.stem for path in paths] == [
        name for name in Evaluation.__dataclass_fields__ if name not in ("bounds", "errors")
    ]
    for path in paths:
        expected = getattr(evaluation, path.stem).reset_index(drop=True)
        stored = pd.read_csv(path, dtype={"value": str})
        stored = stored.fillna({"value": ""}) if "value" in stored else stored
        pd.testing.assert_frame_equal(stored, expected, check_dtype=False)


# Findings -----------------------------------------------------------------------------------------------------------


def sentences(evaluation, **others):
    """The findings of the page, with the warnings among them."""
    return [block.text for block in findings_of(content_of(evaluation, **others)) if isinstance(block, Text)]


def test_errors_in_both_frames_stand_in_the_overview(evaluation):
    cases = evaluation.cases.assign(mean_error_mm=0.25, mean_error_sensor_mm=0.125)
    table = overview(content_of(replace(evaluation, cases=cases)))
    cells = dict(zip(table.header, table.rows[1], strict=True))
    assert (cells["accuracy, mm"], cells["repeatability, mm"]) == ("0.250", "0.125")


def test_the_growth_of_the_error_with_the_leak_is_that_on_the_same_plants(evaluation):
    cases = evaluation.cases
    factor = np.where(cases["leakage_flow_lpm"] == 4.0, cases["family"].map({"step": 3.0, "sine": 2.0}), 1.0)
    errors = cases.assign(mean_error_mm=(1.0 + cases["plant"]) * factor)
    (table,) = growth_table(content_of(replace(evaluation, cases=errors, growth=growth_of(errors))))
    assert table.caption == "Mean error with 4 l/min ÷ mean error with 0.01 l/min, same plants"
    assert table.header == ("Controller", "all runs", "steps", "sines")
    assert table.rows[0] == ("PID", "2.50 (2.50 to 2.50)", "3.00 (3.00 to 3.00)", "2.00 (2.00 to 2.00)")
    assert growth_of(cases[cases["leakage_flow_lpm"] == 4.0]).empty


WIN, LOSS, OPEN = (0.8, 0.7, 0.9), (1.25, 1.1, 1.4), (0.9, 0.7, 1.1)


@pytest.mark.parametrize(
    ("ratio", "lead"),
    [
        (WIN, f"{ODD_NAME} positions best: 80 % of the error of PID."),
        (LOSS, "No controller is clearly better than PID."),
        (OPEN, "No controller is clearly better than PID."),
    ],
)
def test_nobody_is_called_best_without_a_clear_difference(evaluation, ratio, lead):
    ratios = evaluation.ratios.copy()
    ratios.loc[ratios["group"] == "all", ["ratio", "low", "high"]] = ratio
    assert sentences(replace(evaluation, ratios=ratios)) == [lead]


def oscillating(evaluation, *, cycles, largest, failures=0):
    """The evaluation with made-up limit cycles of the first controller and none of the second."""
    summary = pd.DataFrame(
        {
            "controller": evaluation.controllers,
            "limit_cycles": [cycles, 0],
            "standstills": 16,
            "failures": [failures, 0],
            "largest_amplitude_um": [largest, 0.0],
            "frequency_hz": [8.0, np.nan],
        }
    )
    return replace(evaluation, limit_cycle_summary=summary)


@pytest.mark.parametrize(("cycles", "cell"), [(14, "14 of 16 (to 7.9 mm), 1 failed"), (0, "0 of 16")])
def test_a_baseline_that_does_not_come_to_rest_is_warned_of(evaluation, cycles, cell):
    restless = oscillating(evaluation, cycles=cycles, largest=7900.0, failures=cycles // 14)
    warned = [text for text in sentences(restless) if "PID does not come to rest" in text]
    assert len(warned) == (cycles > 0)
    table = overview(content_of(restless))
    assert table.header[-1] == "limit cycles at rest"
    assert [row[-1] for row in table.rows] == [cell, "0 of 16"]


def test_a_policy_is_compared_with_the_controller_that_it_corrects(evaluation):
    rows = evaluation.cases[evaluation.cases["controller"] == ODD_NAME]
    policy = rows.assign(controller="PPO", mean_error_mm=0.9 * rows["mean_error_mm"])
    three = replace(evaluation, cases=pd.concat([evaluation.cases, policy], ignore_index=True))
    tables = {"corrected": Grid(three.cases).corrected({"PPO": ODD_NAME, ODD_NAME: "PID"})}
    (table,) = corrected_table(content_of(three, tables=tables))
    assert table.rows[0][:3] == ("PPO", ODD_NAME, "0.900 (0.900 to 0.900)")
    assert table.rows[0][5:] == ("100", "1.00", "1.00", "1.00")  # better in all runs, at the same costs
    assert tables["corrected"]["controller"].tolist() == ["PPO"]  # the overview compares with the baseline


@pytest.mark.parametrize(
    ("value", "word"),
    [
        ((0.9, 0.85, 0.99), "better"),
        ((1.1, 1.01, 1.2), "worse"),
        ((0.9, 0.8, 1.0), "same"),
        ((0.5, np.nan, np.nan), "same"),  # too few plants for an interval
    ],
)
def test_a_verdict_needs_the_whole_interval_on_one_side(value, word):
    assert verdict(Interval(*value)) == word


def test_shares_and_sizes_of_the_detection_stand_in_its_tables(evaluation):
    rates = evaluation.detection_rates.copy()
    rates.loc[rates["value"] == "0.1–0.2", ["flagged_share", "low", "high"]] = (0.25, 0.2, 0.3)
    summary = evaluation.detection_summary.assign(false_alarm_rate=0.012, median_size_error_factor=[1.31, 1.42])
    content = content_of(replace(evaluation, detection_rates=rates, detection_summary=summary))
    _, by_size, numbers = detection(content)[-1].blocks
    assert next(row for row in by_size.rows if row[0] == "0.1–0.2")[1] == "25.0 % (20.0 to 30.0)"
    cells = {name: cells for name, *cells in numbers.rows}
    assert cells["False alarms at this threshold"] == ["1.2 %", "1.2 %"]
    assert cells["Size: factor of error, half of the leaks within"] == ["1.31", "1.42"]


def test_failed_runs_are_counted(evaluation):
    cases = evaluation.cases.copy()
    cases.loc[[0, 1], "failed"] = 1.0
    text = Page(rendered(replace(evaluation, cases=cases)).html).text
    assert f"Failed runs (end stop or pressure limit): PID 2 of 12, {ODD_NAME} 0 of 12." in text


def test_numbers_and_names_as_a_person_writes_them():
    assert [number(x) for x in (0.0, 1234.5, 12.345, 0.98765, 0.001234)] == ["0", "1234", "12.3", "0.988", "0.00123"]
    assert [number(float("nan")), number(0.0000123), number(948.14, digits=4)] == ["–", "0.0000123", "948.1"]
    assert [number(-12.3), number(-0.0004, 2), number(-0.0)] == ["−12.3", "0.00", "0"]
    assert interval_text(Interval(0.5123, 0.4, 0.6254), "mm") == "0.512 mm (0.400 to 0.625)"
    assert interval_text(Interval(0.5, np.nan, np.nan), "mm") == "0.500 mm"
    assert [duration(x) for x in (1.25, 75.0, 3725.0)] == ["1.2 s", "1 min 15 s", "1 h 2 min"]
    assert correction_name("PPO", "Flow linearisation") == "PPO on flow linearisation"
    assert correction_name("PPO", "PID mended") == "PPO on PID mended"
    assert correction_name("PPO on flow linearisation", "Flow linearisation") == "PPO on flow linearisation"


# Colours and figures ------------------------------------------------------------------------------------------------


def test_controllers_keep_their_look():
    looks = looks_of(["PID", "PPO", "MPC"])
    assert looks_of(["PID", "PPO"])["PPO"] == looks["PPO"]
    assert len({look.colour for look in looks.values()}) == len({look.marker for look in looks.values()}) == 3


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_lines_stand_out_from_the_page_and_from_each_other(theme):
    paper = getattr(NEUTRALS["paper"], theme)
    leaks = [getattr(LEAKS[leak], theme) for leak in sorted(LEAKS)]
    series = {getattr(colour, theme) for colour in SERIES.values()}
    assert all(contrast(colour, paper) >= 3.0 for colour in (*leaks, *series))
    assert all(contrast(getattr(NEUTRALS[name], theme), paper) >= 4.5 for name in ("ink", "grey"))
    brightness = [contrast(colour, "#000000") for colour in leaks]
    assert brightness == sorted(brightness)  # dark is tight
    assert all(LEAK_LOOKS[a].line != LEAK_LOOKS[b].line for a, b in pairwise(sorted(LEAK_LOOKS)))
    assert not set(leaks) & series


def test_bounds_come_from_the_task():
    """With other classes the report speaks of other leaks, and of none of the usual ones."""
    leakage = {"class_bounds": (0.05, 0.6, 2.0), "healthy_range": (0.003, 0.05), "faulty_range": (0.2, 6.0)}
    config = TaskConfig(episode_duration=0.4, leakage=leakage)
    settings = SETTINGS.model_copy(update={"leak_levels": (0.04, 5.0), "families": ("step",)})
    evaluation = evaluate(config, {"PID": PID(PIDGains(), CONFIG)}, untrained_head(CONFIG), settings)
    found = Page(rendered(evaluation, curve=False).html)
    text = found.text + " ".join(svg.get("aria-label", "") for svg in found.all("svg"))
    for wanted in ("up to 0.05 l/min a seal counts as healthy", "0.2–0.3", "with 0.04 l/min", "≥ 0.6"):
        assert wanted in text
    assert not re.search(r"\b0\.03 l/min|\b0\.1 l/min|(?<!–)\b0\.3 l/min|0\.1–0\.2", text)


def test_learning_is_told_against_the_baseline_with_a_band_over_seeds():
    steps = np.array([1e5, 2e5, 3e5])
    seeds = [pd.DataFrame({"steps": steps, ERROR: e, "controller": f"PPO#{n}"}) for n, e in enumerate((0.2, 0.3, 0.7))]
    (plot,) = learning_plots(pd.concat(seeds), "PID", 0.5)
    assert plot.alt.count(" thousand steps 0.600") == 3  # the median seed
    assert "fill-opacity: 0.2" in plot.svg  # the band
    (beside,) = learning_plots(pd.concat(seeds), "PID", 0.5, looks_of(["PID", "Flow linearisation", "PPO"]))
    assert "var(--series-2)" in plot.svg
    assert "var(--series-3)" in beside.svg  # as in the other figures of the page
    assert "var(--series-2)" not in beside.svg
    assert learning_plots(pd.concat(seeds), "PID", float("nan")) == []
    assert len(learning_plots(seeds[0].head(1), "PID", 0.5)) == 1  # validated once
    assert learning_plots(pd.DataFrame({"steps": steps}), "PID", 0.5) == []


@pytest.mark.parametrize("base", [0.34, None])
def test_a_correction_is_shown_beside_what_it_corrects(base):
    curve = pd.DataFrame({"steps": [1e5, 2e5, 3e5], ERROR: [0.36, 0.33, 0.32], BASE_ERROR: base})
    (plot,) = learning_plots(curve if base else curve.drop(columns=BASE_ERROR), "PID", 0.5)
    assert ("<!-- corrected controller -->" in plot.svg) is (base is not None)


# In a browser -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(evaluation, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    examples = [example(evaluation.controllers, leak=leak) for leak in (0.01, 4.0)]
    rendered(evaluation, examples).write(path)
    return path


def test_the_page_holds_the_published_sections(written):
    assert_published_page("study", written.read_text(encoding="utf-8").replace(str(markupsafe.escape(ODD_NAME)), "PPO"))


def test_nothing_is_cut_off_in_a_browser(browser, written):
    assert problems_everywhere(browser, written) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_page_and_figures_follow_the_reader_s_theme(browser, written, scheme):
    with open_page(browser, written, scheme=scheme) as page:

        def shown(selector, what):
            red, green, blue = re.findall(
                r"\d+", page.locator(selector).first.evaluate(f"element => getComputedStyle(element).{what}")
            )[:3]
            return f"#{int(red):02x}{int(green):02x}{int(blue):02x}"

        assert shown("body", "backgroundColor") == getattr(NEUTRALS["paper"], scheme)
        assert shown("body", "color") == getattr(NEUTRALS["ink"], scheme)
        assert shown("figure svg g[id$='-line2d_1'] path", "stroke") in {getattr(c, scheme) for c in VARIABLES.values()}
        assert shown("figure svg g[id*='text_'] g", "fill") == getattr(NEUTRALS["ink"], scheme)
