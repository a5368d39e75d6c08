"""What all figures share: bytes, the mark, sizes, and what the helpers count."""

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

from thalweg.core import CoverageError, InputError
from thalweg.figures import style
from thalweg.figures.survey.maps import survey_map


def texts(figure):
    return [t.get_text() for t in figure.findobj(mpl.text.Text) if t.get_text() and t.get_visible()]


@pytest.mark.parametrize("kind", ["png", "pdf", "svg"])
def test_same_figure_gives_same_bytes(tmp_path, trajectory, positions, kind):
    for name in ("one", "two"):
        style.save(survey_map(trajectory, positions, twin=True), tmp_path / f"{name}.{kind}", dpi=80)
    assert (tmp_path / f"one.{kind}").read_bytes() == (tmp_path / f"two.{kind}").read_bytes()


def test_a_picture_for_a_paper_has_no_title(tmp_path, trajectory):
    figure = survey_map(trajectory, twin=True)
    style.save(figure, tmp_path / "titled.svg")
    height = figure.axes[0].get_position().y1
    style.save(figure, tmp_path / "plain.svg", title=False)
    assert figure.get_suptitle() == ""
    assert figure.axes[0].get_position().y1 > height, "the panel fills its room"
    assert style.TWIN_MARK in texts(figure)


def test_the_users_settings_have_no_say(tmp_path, trajectory):
    style.save(survey_map(trajectory), tmp_path / "plain.png", dpi=80)
    with mpl.rc_context({"font.size": 20, "axes.facecolor": "red", "savefig.bbox": "tight"}):
        style.save(survey_map(trajectory), tmp_path / "loud.png", dpi=80)
    assert (tmp_path / "plain.png").read_bytes() == (tmp_path / "loud.png").read_bytes()


def test_drawing_leaves_the_users_settings_alone(trajectory):
    before = dict(mpl.rcParams)
    survey_map(trajectory)
    assert dict(mpl.rcParams) == before


def test_unknown_format_is_refused(tmp_path, trajectory):
    with pytest.raises(
        InputError, match=r"format 'jpg'; expected one of png, pdf, svg.*Name a file that ends so"
    ):
        style.save(survey_map(trajectory), tmp_path / "map.jpg")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("twin", [True, False])
def test_the_mark_of_the_twin(trajectory, twin):
    figure = survey_map(trajectory, twin=twin)
    marks = [t for t in figure.texts if t.get_gid() == "twin-mark"]
    assert [m.get_text() for m in marks] == (["digital twin"] if twin else [])


def test_a_long_title_keeps_clear_of_the_mark(trajectory):
    title = "Survey map: Freiberger Mulde between the weir and the bridge, second epoch with the higher water"
    figure = survey_map(trajectory, title=title, twin=True)
    figure.draw_without_rendering()
    (mark,) = [t for t in figure.texts if t.get_gid() == "twin-mark"]
    assert figure.get_suptitle().count("\n") >= 1
    assert " ".join(figure.get_suptitle().split("\n")).startswith(title)
    assert figure._suptitle.get_window_extent().x1 < mark.get_window_extent().x0
    assert figure._suptitle.get_window_extent().y0 > figure.axes[0].get_window_extent().y1


def test_robust_limits():
    assert style.robust_limits(np.arange(101.0), 10, 90) == (10.0, 90.0)
    assert style.robust_limits([]) == (0.0, 1.0)
    assert style.robust_limits([np.nan, 5.0, 5.0]) == (2.5, 7.5)
    assert style.robust_limits([0.02, 0.02]) == (0.01, 0.03)  # a sigma stays positive
    assert style.robust_limits([0.0]) == (-0.5, 0.5)


def test_legend_below_fits_the_page():
    draw = style.styled(lambda: style.new_figure(80.0, "n = 0"))
    figure = draw()
    ax = figure.add_subplot()
    for i in range(7):
        ax.plot([], [], label=f"entry {i} with rather many words")
    style.legend_below(figure, ax)
    figure.draw_without_rendering()
    box = figure.legends[0].get_window_extent()
    assert box.x1 <= figure.bbox.x1
    assert len(figure.legends[0].get_texts()) == 7


@style.styled
def two_panels(table, words=""):
    figure = style.new_figure(80.0, f"mean {table['b'].mean():+.1f} cm")
    for ax, name in zip(figure.subplots(1, 2), "ab", strict=True):
        drawn = ax.scatter(table["x"], table[name], c=table[name])
        figure.colorbar(drawn, ax=ax)
        ax.set(xlabel="time / s", ylabel=f"{name} / m", title=f"panel {name}")
        ax.axhline(0.0)
        ax.text(0.5, 0.5, words, transform=ax.transAxes)
    return figure


def texts_of(ax):
    return [" ".join(text.get_text().split()) for text in ax.texts]


TABLE = pd.DataFrame({"x": [1.0, 2.0], "a": [3.0, 4.0], "b": [np.nan, np.nan]})


def test_a_panel_without_a_value_gives_way_to_its_reason():
    figure = two_panels(TABLE)
    full, empty, scale = figure.axes  # the scale of colours of the other panel is gone
    assert scale.get_label() == "<colorbar>"
    assert len(full.collections) == 1
    assert full.axison
    assert texts_of(empty) == ["Left out: no value of b over time."]
    assert not empty.axison
    assert not empty.collections
    assert empty.get_title(loc="left") == "panel b"
    assert figure.get_suptitle() == "mean – cm"
    own = two_panels(TABLE, "no echo came back").axes[1]
    assert texts_of(own) == ["Left out: no echo came back."]


def test_a_figure_without_a_value_says_what_is_missing(tmp_path):
    with pytest.raises(CoverageError, match="no value of a over time, b over time"):
        two_panels(TABLE.assign(a=np.nan))
    with pytest.raises(CoverageError, match="no number in a, b of all 2 rows of 'table'"):
        style.drawn(lambda table: int(table["a"].mean()), TABLE.assign(a=np.nan))
    TABLE.iloc[:0].to_parquet(tmp_path / "t.parquet")
    with pytest.raises(CoverageError, match=r"'t\.parquet' is empty"):
        style.drawn(lambda path: pd.read_parquet(path)["a"].iloc[0], tmp_path / "t.parquet")


def test_a_mistake_of_the_program_stays_one():
    with pytest.raises(IndexError):
        style.drawn(lambda table: table["a"].iloc[7], TABLE[["x", "a"]])


def test_a_line_of_one_point_is_seen():
    @style.styled
    def one():
        figure = style.new_figure(80.0, "n = 1")
        ax = figure.subplots()
        ax.plot([1.0, np.nan], [2.0, 3.0])
        ax.plot([1.0, 2.0], [2.0, 3.0])
        return figure

    assert [line.get_marker() for line in one().axes[0].lines] == [".", "None"]


def test_the_panel_above_takes_over_the_shared_axis():
    @style.styled
    def two():
        figure = style.new_figure(80.0, "n = 2")
        above, below = figure.subplots(2, 1, sharex=True)
        above.plot([1.0, 2.0], [2.0, 3.0])
        below.plot([1.0, 2.0], [np.nan, np.nan])
        below.set(xlabel="time / s", ylabel="b / m")
        return figure

    above, below = two().axes
    assert texts_of(below) == ["Left out: no value of b over time."]
    assert above.get_xlabel() == "time / s"
    assert above.xaxis.get_tick_params()["labelbottom"]


def test_dollar_signs_in_names_are_no_formula(tmp_path):
    """Two of them around bad TeX end matplotlib, around good TeX they change what people wrote."""
    bad, good = "from $\\bad{ to $9", "$x$"

    @style.styled
    def figure_of(words):
        figure = style.new_figure(90.0, words)
        left, right = figure.subplots(1, 2)
        left.barh([words, "b"], [1.0, 2.0], label=words)
        left.set(xlabel=words, title=words)
        left.legend()
        right.plot([1.0, 1e5], [1.0, 2.0])
        right.set_xscale("log")
        right.set_xlabel(words)
        right.annotate(words, (2.0, 1.5))
        right.set_yticks([1.0, 2.0], [words, "b"])
        return figure

    for words in (bad, good):
        figure = figure_of(words)
        style.save(figure, tmp_path / "a.svg")  # asks for each text
        shown = [t for t in figure.findobj(mpl.text.Text) if t.get_visible()]
        found = [t for t in shown if words in t.get_text()]
        assert len(found) == 8
        assert not [t for t in found if t.get_parse_math()]
        powers = figure.axes[1].get_xticklabels()
        assert all(each.get_parse_math() and "mathdefault" in each.get_text() for each in powers)
