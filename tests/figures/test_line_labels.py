"""Figure of labelled scans by several lines."""

import numpy as np
import pandas as pd
import pytest

from thalweg.core import InputError
from thalweg.lightsheet.figures.multi_line import label_words, line_labels, spacing_words

N = 200


@pytest.fixture
def points(rng) -> pd.DataFrame:
    """Three images each; with equal spacing nothing is labelled, else half, of which one is wrong."""
    parts = []
    for irregular in (0.0, 0.3):
        true = rng.integers(0, 15, 3 * N)
        given = (np.arange(3 * N) % 2 == 0) & (irregular > 0)
        line = np.where(given, true, -1)
        if irregular:
            line[0] = (true[0] + 1) % 15
        parts.append(
            pd.DataFrame(
                {
                    "irregular": irregular,
                    "image": np.repeat([0, 1, 2], N),
                    "row": np.tile(np.arange(N), 3),
                    "x_px": 60.0 * true,
                    "line": line,
                    "true_line": true,
                    "reason": np.where(given, "given", "unsure"),
                    "x_mm": np.where(given, true - 7.0, np.nan),
                    "y_mm": np.where(given, 1.0, np.nan),
                    "depth_mm": np.where(given, 120.0 + true, np.nan),
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


@pytest.fixture
def shifts() -> pd.DataFrame:
    rows = [(i, s, 0.03 if s == 0 else 0.04 + i, i > 0) for i in (0.0, 0.3) for s in (-1, 0, 1)]
    return pd.DataFrame(rows, columns=["irregular", "shift", "median_mm", "resolved"])


def test_labels_and_reasons_are_shown_by_spacing(points, shifts, look) -> None:
    figure = line_labels(points, shifts)
    words = look.texts(figure)
    assert f"scans of 3 images: n = 1 200 detections, {3 * N // 2} with a label" in words
    assert "digital twin" in words
    assert "equal spacing no label given" in words
    assert "steps up to 30 % unequal 50 % labelled, 99.7 % of them right" in words
    assert f"no label (grey): {N} unsure: {N}" in words
    equal, unequal = figure.axes[:3], figure.axes[3:6]
    labelled = look.artists(figure, "labelled")
    assert [len(one.get_offsets()) for one in labelled] == [3 * N // 2]  # no panel where no label is given
    (wrong,) = look.artists(figure, "wrong")
    assert len(wrong.get_xdata()) == 1
    # one image each, the middle one
    assert [len(one.get_offsets()) for one in look.artists(figure, "detections")] == [0, N // 2]
    assert [len(one.get_xdata()) for one in look.artists(figure, "without label")] == [N, N // 2]
    assert unequal[1].get_title(loc="left") == "e: image 2"
    assert (unequal[1].get_xlabel(), unequal[1].get_ylabel()) == ("column / px", "row / px")
    assert (unequal[0].get_xlabel(), unequal[0].get_ylabel()) == ("x / mm", "y / mm")
    assert unequal[1].yaxis_inverted()
    for ax, verdict in (
        (equal[2], "not told apart: no labels"),
        (unequal[2], "told apart: labels are given"),
    ):
        assert [text.get_text() for text in ax.texts if "told" in text.get_text()] == [verdict]
        assert len(ax.patches) == 3
        assert ax.get_ylabel() == "median disagreement / mm"
    look.drawn(figure)


def test_words_count_detections_of_real_lines_only() -> None:
    table = pd.DataFrame({"line": [3, 4, -1, 5], "true_line": [3, 5, 1, -1]})
    # two of three real ones have a label; one of three labels is right
    assert label_words(table) == "67 % labelled, 33.3 % of them right"
    assert spacing_words(0.25) == "steps up to 25 % unequal"


def test_missing_columns_are_refused(points, shifts) -> None:
    with pytest.raises(InputError, match="reason"):
        line_labels(points.drop(columns="reason"), shifts)
    with pytest.raises(InputError, match="an empty table"):
        line_labels(points, shifts.iloc[:0])
