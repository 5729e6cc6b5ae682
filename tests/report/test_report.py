"""The report: one self-contained, well-formed page whose sentences say what the tables say."""

import re
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from browser import open_page, problems_everywhere
from contrast import contrast, mixed
from published import assert_published_page
from untrained import untrained_head

from hydro_agents.controllers import PID, ObservationLayout, PIDGains
from hydro_agents.evaluation.evaluate import Evaluation, ProtocolSettings, evaluate
from hydro_agents.evaluation.leak_price import leak_price
from hydro_agents.report.canvas import LEAK_LOOKS, looks_of
from hydro_agents.report.content import interval_text
from hydro_agents.report.pages import StudyRecord, content_of, render_report, write_report, write_tables
from hydro_agents.report.palette import LEAKS, NEUTRALS, SERIES, VARIABLES
from hydro_agents.report.study_findings import caution, failed_runs, findings_of, verdict
from hydro_agents.report.traces import Example, example_plot
from hydro_agents.report.training_plots import learning_plots, training_plots
from hydro_agents.running.statistics import Interval
from hydro_agents.running.text import correction_name, duration, number
from hydro_env import ConfigurationError, TaskConfig

CONFIG = TaskConfig(episode_duration=0.4)
LAYOUT = ObservationLayout.of(CONFIG)
SETTINGS = ProtocolSettings(plants=3, leak_levels=(0.01, 4.0), families=("step", "sine"), detection_episodes=120)
ODD_NAME = 'PPO <b>&"quoted"'
VOID = {"meta", "br", "input"}
KEYS = (
    "level-mean_error_mm-mean", "level-valve_travel_per_s-mean", "difference", "level-reversals_per_s-mean", "family",
    "ratio", "level-mean_error_mm-cvar_5_percent", "level-mean_error_mm-worst", "run-0", "level-supply_energy_j-mean",
    "rates", "roc", "size", "precision", "training",
)  # fmt: skip
NOTHING = pd.DataFrame()


def record(examples=()):
    steps = np.arange(0.0, 5000.0, 100.0)
    curve = pd.DataFrame({"steps": steps, "seconds": steps / 100, "mean_reward": -np.exp(-steps / 1000)})
    curve.loc[0, "mean_reward"] = np.nan
    return StudyRecord(
        title="Trial <one>",
        configuration="task:\n  control_period: 0.005 # <&>\n",
        command="hydro study --seed 3",
        versions={"numpy": "9.9.9"},
        machine="a box with 2 cores",
        seed=3,
        timings={"train PPO": 3725.0, "evaluate": 1.25},
        training_curve=curve,
        examples=list(examples),
    )


def example(names):
    time = np.linspace(0.005, 0.4, 80)
    traces = {name: 0.01 * (1.0 - np.exp(-time / 0.05)) for name in names}
    command = dict.fromkeys(names, 0.1 * time)
    return Example("the same with 4 l/min", time, np.full(80, 0.01), traces, command, leak=4.0)


@pytest.fixture(scope="module")
def evaluation():
    controllers = {
        "PID": PID(PIDGains(proportional=200.0), CONFIG),
        ODD_NAME: PID(PIDGains(proportional=60.0), CONFIG),
    }
    head = untrained_head(CONFIG)
    return evaluate(CONFIG, controllers, head, SETTINGS)


@pytest.fixture(scope="module")
def page(evaluation):
    return render_report(evaluation, record([example(evaluation.controllers)])).html


@pytest.fixture(scope="module")
def lonely():
    """One controller, one level, one family, no head."""
    settings = SETTINGS.model_copy(update={"leak_levels": (0.3,), "families": ("step",), "plants": 2})
    return evaluate(CONFIG, {"PID": PID(PIDGains(), CONFIG)}, None, settings)


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
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.attributes.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.words))

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
    assert set(re.findall(r"url\((.)", page)) <= {"#"}
    assert set(re.findall(r"https?://[^\"' ]*", page)) <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}


def test_ids_are_unique_and_references_find_them(page):
    found = Page(page)
    ids = [attributes["id"] for _, attributes in found.attributes if "id" in attributes]
    assert len(ids) == len(set(ids))
    targets = re.findall(r'(?:href="#|url\(#)([^")]+)', page)
    assert len(targets) > 100
    assert set(targets) <= set(ids)


def test_figures_and_tables_speak_to_everyone(page):
    found = Page(page)
    drawings = re.findall(r'<svg[^>]*role="img".*?</svg>', page, flags=re.DOTALL)
    assert len(drawings) == len(KEYS)
    assert len(found.all("figcaption")) == len(drawings)
    for drawing in drawings:
        root = ElementTree.fromstring(drawing)
        assert root.get("role") == "img"
        assert len(root.get("aria-label")) > 30
        assert root.get("width") is None  # as wide as the page
    assert len(found.all("caption")) == len(found.all("table")) > 10
    assert "reference" in found.text


def test_names_and_texts_are_escaped(page):
    assert "<b>" not in page
    assert "<one>" not in page
    found = Page(page)
    assert ODD_NAME in found.text
    assert "control_period: 0.005 # <&>" in found.text
    assert any(ODD_NAME in attributes.get("aria-label", "") for attributes in found.all("svg"))


def test_the_page_tells_how_it_was_made(page):
    text = Page(page).text
    for wanted in ("hydro study --seed 3", "a box with 2 cores", "9.9.9", "1 h 2 min", "1.2 s", "2000000", "simulated"):
        assert wanted in text
    assert "so no plant used here took part in training" in text
    assert "steps and sines" in text
    assert "are too few for a decision" in text  # three plants


def test_seeds_outside_the_test_set_are_confessed(evaluation):
    cases = evaluation.cases.assign(seed=evaluation.cases["seed"] - 2_000_000)
    text = Page(render_report(replace(evaluation, cases=cases), record()).html).text
    assert "a controller may have been trained on them" in text
    assert "so no plant used here" not in text


def test_the_same_numbers_give_the_same_bytes(evaluation, page, tmp_path):
    import matplotlib

    matplotlib.rcParams["xtick.direction"] = "in"  # a user's own settings
    try:
        write_report(tmp_path / "deep" / "report.html", evaluation, record([example(evaluation.controllers)]))
        assert matplotlib.rcParams["xtick.direction"] == "in"
    finally:
        matplotlib.rcdefaults()
    assert (tmp_path / "deep" / "report.html").read_bytes() == page.encode()
    assert sorted(path.name for path in (tmp_path / "deep").iterdir()) == ["figures", "report.html"]
    assert sorted(path.stem for path in (tmp_path / "deep" / "figures").iterdir()) == sorted(KEYS)
    drawing = ElementTree.parse(tmp_path / "deep" / "figures" / "ratio.svg").getroot()  # whole by itself
    assert drawing.get("width") == "331.2pt"


def test_a_report_that_cannot_be_written_says_so(evaluation, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="cannot be written"):
        write_report(tmp_path / "file" / "report.html", evaluation, record())


def test_one_controller_without_a_head(lonely, tmp_path):
    text = Page(render_report(lonely, replace(record(), training_curve=NOTHING, versions={}, timings={})).html).text
    assert "One leak size was tried: 0.3 l/min" in text.replace("\u00a0", " ")
    assert "without intervals" in text
    for absent in ("Detecting the leak", "Ratio of errors", "Difference to", "nan", "AUROC"):
        assert absent not in text
    names = [path.name for path in write_tables(tmp_path / "tables", lonely)]
    assert names == ["cases.csv", "levels.csv", "families.csv"]


def test_tables_hold_all_numbers(evaluation, tmp_path):
    paths = write_tables(tmp_path, evaluation)
    tables = [name for name in Evaluation.__dataclass_fields__ if name not in ("bounds", "errors")]
    assert [path.stem for path in paths] == tables
    for path in paths:
        expected = getattr(evaluation, path.stem).reset_index(drop=True)
        stored = pd.read_csv(path, dtype={"value": str}, keep_default_na=True)
        stored["value"] = stored["value"].fillna("") if "value" in stored else None
        stored = stored if "value" in expected else stored.drop(columns="value")
        pd.testing.assert_frame_equal(stored, expected, check_dtype=False)


# Findings -----------------------------------------------------------------------------------------------------------


def leads(evaluation):
    return [item.lead.replace("\u00a0", " ") for item in findings_of(content_of(evaluation))]


def texts(evaluation):
    return [item.text.replace("\u00a0", " ") for item in findings_of(content_of(evaluation))]


def with_errors(evaluation, factor):
    """The same evaluation with an error of PID that grows by ``factor(family)`` from the small leak to the large."""
    cases = evaluation.cases.copy()
    large = cases["leakage_flow_lpm"] == 4.0
    growth = np.where(large, cases["family"].map(factor), 1.0)
    cases["mean_error_mm"] = (1.0 + cases["plant"]) * growth
    levels = evaluation.levels.copy()
    told = (levels["metric"] == "mean_error_mm") & (levels["controller"] == "PID")
    levels.loc[told & (levels["leakage_flow_lpm"] == 0.01), ["mean", "low", "high"]] = (0.512, 0.4, 0.625)
    return replace(evaluation, cases=cases, levels=levels)


def test_what_a_leak_does(evaluation):
    worse = with_errors(evaluation, {"step": 3.0, "sine": 2.0}.get)
    assert leads(worse)[0] == (
        "With a leak of 4 l/min, PID makes 2.50 times the error that it makes with a healthy seal (0.01 l/min)."
    )
    assert "0.512 mm (0.400 to 0.625) mean error with a healthy seal (0.01 l/min)" in texts(worse)[0]
    assert "× 2.50 (2.50 to 2.50). More error in steps (× 3.00) and sines (× 2.00)." in texts(worse)[0]
    mixed = with_errors(evaluation, {"step": 1.5, "sine": 0.4}.get)
    assert leads(mixed)[0].startswith("With a leak of 4 l/min, PID makes 5 % less error than")
    assert "More error in steps (× 1.50); less error in sines (× 0.400)." in texts(mixed)[0]
    same = with_errors(evaluation, {"step": 1.0, "sine": 1.0}.get)
    assert leads(same)[0] == "A leak of 4 l/min makes no clear difference to the mean error of PID."
    assert "No clear difference in steps (× 1.00) and sines (× 1.00)." in texts(same)[0]


def with_ratios(evaluation, whole, levels, families):
    ratios = evaluation.ratios.copy()
    ratios[["ratio", "low", "high"]] = [whole, *levels, *families, whole]  # the last: equal weights of references
    ratios["share_of_cases_better"] = 0.75
    return replace(evaluation, ratios=ratios)


WIN, LOSS, OPEN = (0.8, 0.7, 0.9), (1.25, 1.1, 1.4), (0.9, 0.7, 1.1)


def test_who_copes_better(evaluation):
    won = with_ratios(evaluation, WIN, [WIN, WIN], [OPEN, LOSS])
    assert leads(won)[1] == f"{ODD_NAME} positions better than PID: 20 % less error."
    assert "is 0.800 (0.700 to 0.900) times that of PID" in texts(won)[1]
    assert "better in 75 % of the runs" in texts(won)[1]
    assert "It wins at every leak size." in texts(won)[1]
    assert "By reference it loses on sines; shows no clear difference on steps." in texts(won)[1]
    lost = with_ratios(evaluation, LOSS, [WIN, LOSS], [LOSS, LOSS])
    assert leads(lost)[1] == f"{ODD_NAME} loses to PID: 25 % more error."
    assert "By leak size it wins at 0.01 l/min; loses at 4 l/min." in texts(lost)[1]
    assert "It loses on every kind of reference." in texts(lost)[1]
    assert leads(with_ratios(evaluation, OPEN, [OPEN, OPEN], [OPEN, OPEN]))[1].startswith("No clear difference between")


def test_verdicts():
    assert verdict(Interval(0.9, 0.85, 0.99), 32) == "wins"
    assert verdict(Interval(1.1, 1.01, 1.2), 32) == "loses"
    assert verdict(Interval(0.9, 0.8, 1.0), 32) == "no clear difference"
    assert verdict(Interval(0.5, 0.5, 0.5), 2) == "no clear difference"  # two plants say nothing
    assert verdict(Interval(0.5, np.nan, np.nan), 32) == "no clear difference"


def with_detection(evaluation, found, alarms):
    """Detection tables with a share of found leaks from 0.3 l/min and of false alarms, 1000 episodes each."""
    rates, summary = evaluation.detection_rates.copy(), evaluation.detection_summary.copy()
    rates.loc[rates["value"] == "≥ 0.3", ["flagged_share", "low", "high"]] = (found, found - 0.02, found + 0.01)
    rates.loc[rates["value"] == "0.1–0.2", ["flagged_share", "low", "high"]] = (0.25, 0.2, 0.3)
    summary["false_alarm_rate"], summary["healthy_episodes"] = alarms, 1000
    summary["auroc"] = 0.9876
    summary["median_size_error_factor"], summary["p90_size_error_factor"] = [1.31, 1.42], [2.5, 3.0]
    return replace(evaluation, detection_rates=rates, detection_summary=summary)


def test_whether_leaks_are_noticed(evaluation):
    good = with_detection(evaluation, 0.97, 0.012)
    assert leads(good)[2] == "Leaks from 0.3 l/min can be flagged from one episode of ordinary motion."
    assert (
        "97.0 % (95.0 to 98.0) of the leaks from 0.3 l/min, 25.0 % (20.0 to 30.0) of those of 0.1–0.2" in texts(good)[2]
    )
    assert "1.2 % (0.7 to 2.1) of the healthy seals (false alarms); AUROC 0.988." in texts(good)[2]
    assert "clearly more" not in texts(good)[2]
    assert leads(good)[3] == "The size of a leak is estimated within a factor of 1.42 for half of the leaks."
    assert f"2.50 under PID and 3.00 under {ODD_NAME}" in texts(good)[3]
    assert leads(with_detection(evaluation, 0.6, 0.01))[2].endswith("can be flagged, but not reliably.")
    assert leads(with_detection(evaluation, 0.97, 0.2))[2].endswith("can be flagged, but not reliably.")
    bad = with_detection(evaluation, 0.05, 0.04)
    assert leads(bad)[2].startswith("Leaks from 0.3 l/min cannot be distinguished")
    assert f"clearly more under PID and {ODD_NAME}" in texts(bad)[2]


def test_failures_and_few_plants_are_said(evaluation):
    assert failed_runs(content_of(evaluation)) == "No run failed (end stop or pressure limit)."
    cases = evaluation.cases.copy()
    cases.loc[[0, 1], "failed"] = 1.0
    assert failed_runs(content_of(replace(evaluation, cases=cases))).endswith(
        f"2 of 12 under PID and 0 of 12 under {ODD_NAME}."
    )
    many = pd.concat([cases.assign(plant=cases["plant"] + 3 * i) for i in range(8)])
    assert caution(content_of(replace(evaluation, cases=many))) == ""
    assert "3 plants" in caution(content_of(evaluation))


def test_numbers_as_a_person_writes_them():
    assert [number(x) for x in (0.0, 1234.5, 12.345, 0.98765, 0.001234)] == ["0", "1234", "12.3", "0.988", "0.00123"]
    assert number(float("nan")) == "–"
    assert interval_text(Interval(0.5123, 0.4, 0.6254), "mm") == "0.512 mm (0.400 to 0.625)"
    assert interval_text(Interval(0.5, np.nan, np.nan), "mm") == "0.500 mm"
    assert [duration(x) for x in (1.25, 75.0, 3725.0)] == ["1.2 s", "1 min 15 s", "1 h 2 min"]


def test_controllers_keep_their_look():
    looks = looks_of(["PID", "PPO", "MPC"])
    assert looks_of(["PID", "PPO"])["PPO"] == looks["PPO"]
    assert len({look.colour for look in looks.values()}) == 3
    assert len({look.marker for look in looks.values()}) == 3


def test_numbers_have_a_true_minus_and_no_signed_zero():
    values = [number(-12.3), number(-0.0004, 2), number(0.09, 2, signed=True), number(-0.0, signed=True)]
    assert values == ["−12.3", "0.00", "+0.09", "0"]
    assert number(0.0000123) == "0.0000123"
    assert number(948.14, digits=4) == "948.1"


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_lines_stand_out_from_the_page_and_from_each_other(theme):
    paper = getattr(NEUTRALS["paper"], theme)
    leaks = [getattr(LEAKS[leak], theme) for leak in sorted(LEAKS)]
    assert all(contrast(colour, paper) >= 3.0 for colour in leaks)
    assert all(contrast(getattr(colour, theme), paper) >= 3.0 for colour in SERIES)
    assert all(contrast(getattr(NEUTRALS[name], theme), paper) >= 4.5 for name in ("ink", "grey"))
    brightness = [contrast(colour, "#000000") for colour in leaks]
    assert brightness == sorted(brightness)  # dark is tight
    drawn = sorted(LEAK_LOOKS)
    assert all(LEAK_LOOKS[a].line != LEAK_LOOKS[b].line for a, b in pairwise(drawn))
    assert not set(leaks) & {getattr(colour, theme) for colour in SERIES}


def test_contrast_is_that_of_wcag():
    assert contrast("#ffffff", "#000000") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)  # a published example
    assert mixed("#ff0000", "#0000ff", 50) == "#800080"


def test_every_colour_of_a_figure_follows_the_theme(page):
    drawings = re.findall(r'<svg[^>]*role="img".*?</svg>', page, flags=re.DOTALL)
    assert {colour for drawing in drawings for colour in re.findall(r"#[0-9a-f]{6}\b", drawing)} == set()


def test_a_point_tells_its_value(page):
    drawing = re.search(r'<svg[^>]*aria-label="Mean error by leak size.*?</svg>', page, flags=re.DOTALL)[0]
    titles = [element.text for element in ElementTree.fromstring(drawing).iter("{http://www.w3.org/2000/svg}title")]
    label = re.search(r"PID: 0.01 l/min (\S+) mm", drawing)[1]
    assert f"PID\nleak 0.01 l/min at 100 bar\nerror {label} mm" in titles
    assert len(titles) == 4  # two controllers at two leaks


def test_bounds_come_from_the_task():
    """With other classes the report speaks of other leaks, and of none of the usual ones."""
    leakage = {"class_bounds": (0.05, 0.6, 2.0), "healthy_range": (0.003, 0.05), "faulty_range": (0.2, 6.0)}
    config = TaskConfig(episode_duration=0.4, leakage=leakage)
    settings = SETTINGS.model_copy(update={"leak_levels": (0.04, 5.0), "families": ("step",)})
    head = untrained_head(CONFIG)
    evaluation = evaluate(config, {"PID": PID(PIDGains(), CONFIG)}, head, settings)
    page = render_report(evaluation, replace(record(), training_curve=NOTHING)).html
    found = Page(page)
    text = (found.text + " ".join(svg.get("aria-label", "") for svg in found.all("svg"))).replace("\u00a0", " ")
    for wanted in (
        "up to 0.05 l/min a seal counts as healthy",
        "Leaks from 0.6 l/min c",
        "leaks above 0.2 l/min",
        "a healthy seal (0.04 l/min)",
        "≥ 0.6",
    ):
        assert wanted in text
    for usual in (r"\b0\.03 l/min", r"\b0\.1 l/min", r"(?<!–)\b0\.3 l/min", "0.1–0.2"):
        assert not re.search(usual, text)


def test_a_policy_that_corrects_is_called_so(evaluation):
    names = evaluation.controllers
    corrects = replace(record([example(names)]), corrects={ODD_NAME: "PID", "absent": "PID"})
    text = Page(render_report(evaluation, corrects).html).text.replace("\u00a0", " ")
    assert f"{ODD_NAME} on PID is a policy that adds a correction to the command of PID." in text
    assert "absent" not in text
    assert not re.search(re.escape(ODD_NAME) + "(?! on PID)", text)
    assert evaluation.controllers == names  # the tables keep their names


def test_the_preview_is_marked_beside_a_step():
    time = np.arange(1, 81) * 0.005
    step = np.where(time > 0.2, 0.01, 0.0)
    shown = Example("steps", time, step, {"PID": step}, {"PID": step}, preview=0.04)
    with_preview = example_plot(shown, "run", looks_of(["PID"]))
    without = example_plot(replace(shown, preview=0.0), "run", looks_of(["PID"]))
    assert "40 ms ahead" in with_preview.note
    values = [
        element.text for element in ElementTree.fromstring(with_preview.svg).iter("{http://www.w3.org/2000/svg}title")
    ]
    assert any("preview, 40 ms ahead" in value for value in values)  # a line of its own
    assert not any(
        "ahead" in element.text
        for element in ElementTree.fromstring(without.svg).iter("{http://www.w3.org/2000/svg}title")
    )
    assert "ahead" not in without.note
    assert len(with_preview.svg) > len(without.svg)
    smooth = replace(shown, reference=0.01 * time)
    assert "ahead" not in example_plot(smooth, "run", looks_of(["PID"])).note


def test_the_log_of_a_training_is_drawn():
    steps = np.linspace(1e4, 1e6, 50)
    log = pd.DataFrame(
        {
            "time/total_timesteps": steps,
            "rollout/mean_reward": -1.0 - 50.0 * np.exp(-steps / 1e4),
            "train/approx_kl": 0.01,
            "train/explained_variance": np.linspace(0.0, 0.9, 50),
            "validation/mean_error_mm": np.where(np.arange(50) % 10 == 0, 0.3, np.nan),
        }
    )
    plots = training_plots(log)
    assert [plot.title for plot in plots] == [
        "Reward while learning",
        "Error on validation plants",
        "Updates of the policy",
    ]
    assert "early values beyond the scale" in plots[0].note
    assert "explained variance of the value function from 0 to 0.900" in plots[2].alt
    assert training_plots(log[["time/total_timesteps"]]) == []
    assert training_plots(pd.DataFrame()) == []
    two = pd.concat([log.assign(controller="PPO"), log.assign(controller="SAC")])
    assert "of SAC" in training_plots(two)[0].alt


def test_learning_is_told_against_the_baseline_with_a_band_over_seeds():
    steps = np.array([1e5, 2e5, 3e5])
    error = "validation/mean_error_mm"
    seeds = [pd.DataFrame({"steps": steps, error: e, "controller": f"PPO#{n}"}) for n, e in enumerate((0.2, 0.3, 0.7))]
    (plot,) = learning_plots(pd.concat(seeds), "PID", 0.5)
    assert "PPO: after 100 thousand steps 0.600, after 300 thousand steps 0.600" in plot.alt  # the median seed
    assert "median of 3 training seeds" in plot.note
    looks = looks_of(["PID", "Flow linearisation", "PPO"])
    (beside,) = learning_plots(pd.concat(seeds), "PID", 0.5, looks)
    assert "var(--series-2)" in plot.svg
    assert "var(--series-3)" in beside.svg  # as in the other figures of the page
    assert "var(--series-2)" not in beside.svg
    assert learning_plots(pd.concat(seeds), "PID", float("nan")) == []
    assert len(learning_plots(seeds[0].head(1), "PID", 0.5)) == 1  # validated once
    assert learning_plots(pd.DataFrame({"steps": steps}), "PID", 0.5) == []


@pytest.mark.parametrize(("base", "near"), [(0.34, True), (0.1, False)])
def test_a_small_correction_is_shown_beside_what_it_corrects(base, near):
    columns = {"validation/mean_error_mm": [0.36, 0.33, 0.32], "validation/base_mean_error_mm": base}
    curve = pd.DataFrame({"steps": [1e5, 2e5, 3e5], **columns})
    (plot,) = learning_plots(curve, "PID", 0.5)
    assert "Dotted: the controller that is corrected." in plot.note
    assert ("does not begin at zero" in plot.note) is near
    (alone,) = learning_plots(curve.drop(columns="validation/base_mean_error_mm"), "PID", 0.5)
    assert "Dotted" not in alone.note


def test_a_correction_is_named_after_what_it_corrects():
    assert correction_name("PPO", "Flow linearisation") == "PPO on flow linearisation"
    assert correction_name("PPO", "PID mended") == "PPO on PID mended"


# In a browser -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(evaluation, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    names = evaluation.controllers
    examples = [replace(example(names), leak=leak, preview=0.04) for leak in (0.01, 4.0)]
    price = leak_price(CONFIG, (0.01, 4.0))
    write_report(path, evaluation, replace(record(examples), leak_price=price, corrects={ODD_NAME: "PID"}))
    return path


def test_the_page_holds_the_published_sections(written):
    assert_published_page("study", written.read_text(encoding="utf-8").replace(escape(ODD_NAME), "PPO"))


def test_nothing_is_cut_off_in_a_browser(browser, written):
    assert problems_everywhere(browser, written) == []


def test_the_slider_shows_one_leak_at_a_time(browser, written):
    with open_page(browser, written) as page:
        shown = page.locator(".chosen >> visible=true")
        assert [shown.count(), shown.first.get_attribute("data-value")] == [1, "0.01"]
        page.locator(".slider input").fill("1")
        assert [shown.count(), shown.first.get_attribute("data-value")] == [1, "4"]
        assert page.locator(".slider output").text_content() == "4"
        assert "With any controller" in shown.first.text_content()


def test_without_scripts_every_leak_is_shown(browser, written):
    with open_page(browser, written, java_script_enabled=False) as page:
        assert page.locator(".chosen >> visible=true").count() == 2
        assert not page.locator(".slider").is_visible()


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
