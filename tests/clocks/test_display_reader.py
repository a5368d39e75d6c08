"""Reading the number on a photographed clock, and what the intervals say about the camera."""

from contextlib import suppress
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image, ImageDraw, ImageFont
from scipy.stats import chi2

from thalweg.clocks import clock_stability, read_display
from thalweg.clocks.display import _cycle, find_layouts, out_of_sequence, seconds_of
from thalweg.core import ClockError, InputError
from thalweg_lab.instruments import simulate_display
from thalweg_lab.settings import TwinConfig

STEP_S = 0.01


@pytest.fixture(scope="module", params=["font", "segments"])
def series(request, tmp_path_factory):
    """Three minutes of the twin's photographs, and the truth about them."""
    folder = tmp_path_factory.mktemp(request.param)
    twin = TwinConfig(size="field")
    display = twin.camera.display.model_copy(update={"digits": request.param, "duration_s": 180.0})
    config = twin.model_copy(update={"camera": twin.camera.model_copy(update={"display": display})})
    truth = simulate_display(config, 5, folder / "photos", folder / "truth.parquet")
    return sorted((folder / "photos").iterdir()), truth


def test_the_twins_photographs_are_read_or_left_out(series):
    files, truth = series
    table, facts = read_display(files)
    both = table.merge(truth, on="file")
    read = both["reason"] == ""
    assert facts["read"] == read.sum()
    assert facts["read"] + sum(facts["left_out"].values()) == facts["photographs"] == len(files)
    # nothing that is spoiled is read
    assert not read[both["spoiled"] != ""].any()
    # where the display changes in the middle of the exposure there is no right number; the rest is read
    assert read.sum() > 0.7 * both["readable"].sum()
    shown = np.array([seconds_of(text, "HH:MM:SS.ff") for text in both["shown"]])
    error = np.abs(both["t_display_s"] - shown)[read]
    # a neighbouring number is off by the display's step; anything else is a misread digit
    assert (error < 0.005).mean() > 0.97
    assert (error > 1.5 * STEP_S).mean() < 0.006
    found = clock_stability(both["t_display_s"].to_numpy(), step_s=STEP_S)
    # the truth of the same photographs: what remains is the reader's own
    t = both["t_gps_s"].to_numpy()
    used = read.to_numpy()[1:] & read.to_numpy()[:-1]
    true = np.diff(t)[used]
    assert found.mean_s == pytest.approx(np.diff(t).mean(), rel=0.02)
    assert found.std_s == pytest.approx(true.std(ddof=1), rel=0.05)
    # P2's numbers: 180 intervals have a sigma of 5.3 % of their own
    assert found.std_s == pytest.approx(0.023, rel=0.17)
    assert found.kind == "white stamps"


def dejavu(name):
    return str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / f"{name}.ttf")


def photographs(folder, texts, font, *, bright=False, seed=1):
    """Photographs of a monitor in a room: a window with digits somewhere in a larger picture, seen askew."""
    rng = np.random.default_rng(seed)
    face = ImageFont.truetype(font, 60)
    corners = np.array([[0, 0], [520, 0], [520, 120], [0, 120]], np.float32)
    there = np.array([[203, 95], [478, 118], [472, 190], [199, 158]], np.float32)
    H = cv2.getPerspectiveTransform(corners, there)
    room = cv2.GaussianBlur(rng.uniform(20, 90, (360, 640)).astype(np.float32), (0, 0), 25) * 1.0
    folder.mkdir(parents=True)
    out = []
    for k, text in enumerate(texts):
        window = Image.new("L", (520, 120), 30 if bright else 215)
        ImageDraw.Draw(window).text((260, 60), text, fill=225 if bright else 25, font=face, anchor="mm")
        picture = cv2.warpPerspective(
            np.asarray(window, np.float32), H, (640, 360), dst=room.copy(), borderMode=cv2.BORDER_TRANSPARENT
        )
        picture = cv2.GaussianBlur(picture, (0, 0), 0.8) + rng.normal(0, 3, picture.shape)
        path = folder / f"D{k:04d}.png"
        Image.fromarray(np.clip(picture, 0, 255).astype(np.uint8)).save(path, compress_level=1)
        out.append(path)
    return out


def clock_texts(n, seed=3, start=50_000.0):
    rng = np.random.default_rng(seed)
    t = np.floor((start + np.arange(n) * 1.003 + 0.02 * rng.standard_normal(n)) * 100 + 0.5) / 100
    return [f"{int(s // 3600):02d}:{int(s // 60 % 60):02d}:{s % 60:05.2f}" for s in t], t


@pytest.mark.parametrize(("font", "bright"), [("DejaVuSans-Bold", True), ("DejaVuSerif", False)])
def test_fonts_that_are_not_built_in_are_read(tmp_path, font, bright):
    texts, t = clock_texts(20)
    table, facts = read_display(photographs(tmp_path / "a", texts, dejavu(font), bright=bright))
    read = table["reason"] == ""
    assert read.mean() > 0.9
    assert table["text"][read].tolist() == [text for text, good in zip(texts, read, strict=True) if good]
    assert_allclose(table["t_display_s"][read], t[read], atol=1e-6)
    assert facts["ink"] == ("bright" if bright else "dark")


def test_labels_teach_a_look_of_its_own(tmp_path):
    """Ten labelled photographs instead of the built-in digits."""
    texts, _ = clock_texts(20)
    files = photographs(tmp_path / "a", texts, dejavu("DejaVuSerif-Bold"))
    nine = next(k for k, text in enumerate(texts) if "9" in text)
    labels = {files[k].name: texts[k] for k in [*range(0, 20, 2), nine]}
    table, _ = read_display(files, labels=labels)
    read = table["reason"] == ""
    assert read.mean() > 0.9
    assert table["text"][read].tolist() == [text for text, good in zip(texts, read, strict=True) if good]
    for wrong in (
        {"absent.png": texts[0]},
        {files[0].name: texts[0][:-1]},
        {files[0].name: "x" + texts[0][1:]},
    ):
        with pytest.raises(InputError, match="label"):
            read_display(files, labels=wrong)


def test_damaged_and_foreign_files_are_left_out_with_their_reason(tmp_path):
    texts, _ = clock_texts(20)
    files = photographs(tmp_path / "a", texts, dejavu("DejaVuSansMono"))
    files[3].write_bytes(b"")
    files[5].write_bytes(files[6].read_bytes()[:500])
    Image.new("L", (320, 200)).save(files[7])
    Image.new("L", (640, 360), 40).save(files[9])
    Image.new("L", (640, 360), 255).save(files[11])
    table, facts = read_display(files)
    reasons = dict(zip(table["file"], table["reason"], strict=True))
    assert reasons[files[3].name] == "unreadable file"
    assert reasons[files[7].name] == "another size"
    assert reasons[files[9].name] == "covered or dark"
    assert reasons[files[11].name] == "glare"
    assert facts["read"] >= 13
    read = table["reason"] == ""
    assert table["text"][read].tolist() == [text for text, good in zip(texts, read, strict=True) if good]


def test_a_folder_without_a_display_is_refused(tmp_path):
    rng = np.random.default_rng(1)
    files = []
    for k in range(6):
        path = tmp_path / f"{k}.png"
        Image.fromarray(rng.integers(0, 40, (120, 200)).astype(np.uint8)).save(path)
        files.append(path)
    with suppress(InputError):
        # noise may look like a line of digits; nothing is read from it
        assert (read_display(files)[0]["reason"] != "").all()
    for path in files:
        path.write_bytes(b"x")
    with pytest.raises(InputError, match="can be opened"):
        read_display(files)
    with pytest.raises(InputError, match="a series"):
        read_display(files[:1])


def test_texts_that_are_no_time():
    assert seconds_of("23:59:59.99", "HH:MM:SS.ff") == pytest.approx(86_399.99)
    assert seconds_of("24:00:00.00", "HH:MM:SS.ff") is None
    assert seconds_of("00:00:61.00", "HH:MM:SS.ff") is None
    assert seconds_of("345678.25", "SSSSSS.ff") == pytest.approx(345_678.25)
    assert seconds_of("07:05.250", "MM:SS.fff") == pytest.approx(425.25)
    assert seconds_of("60:00", "MM:SS") is None
    assert seconds_of("61", "SS") == 61.0
    assert seconds_of("0?:05", "MM:SS") is None
    cycles = [_cycle(p) for p in ("HH:MM:SS", "MM:SS.f", "SS.ff", "SSS.f", "SSSS")]
    assert cycles == [86_400.0, 3600.0, 60.0, 1000.0, 10_000.0]


def test_patterns_without_digits_and_photographs_of_two_sizes_have_no_layout():
    with pytest.raises(InputError, match="the pattern ':d' of the display"):
        find_layouts([np.zeros((60, 80), np.uint8)], ":d")
    with pytest.raises(InputError, match="different sizes"):
        find_layouts([np.zeros((60, 80), np.uint8), np.zeros((80, 60), np.uint8)], "dd:dd")
    assert find_layouts([np.zeros((60, 80), np.uint8)], "dd") == []


def test_the_sequence_only_rejects():
    rng = np.random.default_rng(2)
    t = 86_395.0 + np.arange(60) + 0.016 * rng.standard_normal(60)
    t[30:] += 5.0  # five photographs are missing: no reason to reject
    shown = t % 86_400.0
    shown[12] += 8.0  # a misread second
    shown[40] -= 3600.0  # a misread hour
    shown[20] = np.nan
    other = np.full(60, np.nan)
    shown[50] += 0.06
    other[50] = shown[50] - 0.06  # the second digit in mind would fit
    other[51] = shown[51] + 0.01
    found, wrong, doubtful = out_of_sequence(shown, other)
    assert np.flatnonzero(wrong).tolist() == [12, 40]
    assert np.flatnonzero(doubtful).tolist() == [50]
    good = np.isfinite(found) & ~wrong & ~doubtful
    assert_allclose(found[good], t[good])


# ---------------------------------------------------------------- stability


def readings(rng, kind, n=1000):
    """Readings of a display of 100 Hz, a tenth of them lost."""
    stamp = {"white": 0.023 / np.sqrt(2), "wander": 0.0, "both": 0.015}[kind]
    wander = {"white": 0.0, "wander": 0.023, "both": 0.012}[kind]
    t = 100.0 + np.cumsum(0.999 + wander * rng.standard_normal(n)) + stamp * rng.standard_normal(n)
    t = np.floor(t / STEP_S) * STEP_S
    t[rng.random(n) < 0.1] = np.nan
    return t


@pytest.mark.parametrize(
    ("kind", "word"), [("white", "white stamps"), ("wander", "wandering intervals"), ("both", "both")]
)
def test_white_stamps_and_wandering_intervals_are_told_apart(kind, word):
    rng = np.random.default_rng(6)
    true = float(np.hypot(0.012, 0.015 * np.sqrt(2))) if kind == "both" else 0.023
    found = [clock_stability(readings(rng, kind)) for _ in range(60)]
    # three sigmas for either part: a few percent of the mixtures go to the stronger one
    assert sum(f.kind == word for f in found) >= 0.8 * len(found)
    low, high = chi2.ppf([0.0005, 0.9995], 60) / 60
    std = np.mean([((f.std_s - true) / f.sigma_std_s) ** 2 for f in found])
    assert low < std < high
    mean = np.mean([((f.mean_s - 0.999) / f.sigma_mean_s) ** 2 for f in found])
    # white stamps: the sigma holds the wander that cannot be excluded, and is then too large
    assert mean < high
    if kind == "wander":
        assert mean > low
        assert np.median([f.count_error_s for f in found]) == pytest.approx(0.023 * 60, rel=0.1)
    if kind == "white":
        assert np.median([f.image_error_s for f in found]) == pytest.approx(0.023 / np.sqrt(2), rel=0.05)


def test_steps_of_the_display_are_taken_off():
    """A display of 33 Hz shows 12 ms of its own; the camera's 23 ms are found all the same."""
    rng = np.random.default_rng(8)
    t = np.arange(20_000) * 0.999 + 0.023 / np.sqrt(2) * rng.standard_normal(20_000)
    found = clock_stability(np.floor(t / 0.03) * 0.03, step_s=0.03)
    assert found.raw_std_s == pytest.approx(np.hypot(0.023, 0.03 / np.sqrt(6)), rel=0.02)
    assert found.std_s == pytest.approx(0.023, abs=4 * found.sigma_std_s)


def test_lost_photographs_are_multiples_and_no_noise():
    rng = np.random.default_rng(7)
    t = np.delete(np.arange(500) * 0.999 + 0.01 * rng.standard_normal(500), [50, 51, 300])
    found = clock_stability(t)
    assert found.lost == 3
    assert found.std_s == pytest.approx(0.01 * np.sqrt(2), rel=0.15)
    assert found.mean_s == pytest.approx(0.999, abs=1e-4)


def test_a_drift_of_the_interval_is_found():
    rng = np.random.default_rng(9)
    k = np.arange(5000)
    # 1000 ppm an hour: the interval grows by 0.001 * 0.999 in 3600 s
    t = 0.999 * k + 0.5 * (1e-3 * 0.999 / 3600) * k**2 + 0.016 * rng.standard_normal(5000)
    found = clock_stability(t)
    assert found.drift_ppm_per_h == pytest.approx(1000, abs=4 * found.sigma_drift_ppm_per_h)
    assert found.sigma_drift_ppm_per_h < 250
    assert any("ppm an hour" in note for note in found.notes)


def test_too_few_neighbours_are_refused():
    t = np.arange(50.0)
    t[::2] = np.nan
    with pytest.raises(ClockError, match="0 of them beside one another"):
        clock_stability(t)
    with pytest.raises(ClockError, match="advances"):
        clock_stability(np.full(50, 3.0))
