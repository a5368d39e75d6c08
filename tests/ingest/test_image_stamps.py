"""Times of photographs: from names, EXIF and tables, with everything that is wrong told."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from tests.ingest.writers import noted, numbers
from thalweg.core import ClockError, InputError, gps_from_unix, read_table, write_table
from thalweg.ingest import explain_shift
from thalweg.ingest.photos import IMAGE_STAMPS, list_images, read_head, read_image_stamps
from thalweg.ingest.photos.exif import CivilStamp, offset_seconds, stamp_from_exif
from thalweg.ingest.photos.stamps import _stamp, compile_pattern, read_time_table, stamp_from_name

UNIX = 1_620_808_267  # 2021-05-12T08:31:07Z
T0 = float(gps_from_unix(UNIX))


def photo(
    path: Path,
    when: str | None = None,
    fraction: str | None = None,
    offset: str | None = None,
    size: tuple[int, int] = (32, 24),
) -> Path:
    """A small JPEG with the EXIF tags that are given."""
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = "Panasonic", "DMC-GX80"
    inner = exif.get_ifd(0x8769)
    for tag, text in ((0x9003, when), (0x9291, fraction), (0x9011, offset)):
        if text is not None:
            inner[tag] = text
    inner[0x920A] = 14.0
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size).save(path, exif=exif)
    return path


NAMES = """\
0.123       1e-3 R20210512_083107123
0.123       1e-3 IMG_20210512_083107_123
0.123       1e-3 2021-05-12T08-31-07.123
0.123       1e-3 PXL_20210512_083107123.MP
0.123456    1e-6 cam1_2021-05-12_08.31.07.123456
0           1    20210512_083107
0.123       1e-3 1620808267123
0.123456    1e-6 frame_1620808267.123456
0.123456789 1e-9 1620808267123456789
0.123456789 1e-9 2021-05-12T08-31-07.123456789
43200       1    2021-05-12 08.31.07 PM
0           1    2021-05-12 08.31.07 am
0           1    20210512_083107-0400
0           1    20210512_083107+123
0           1    IMG_20210512_083107_1
"""
"""Seconds behind 2021-05-12T08:31:07Z, resolution, name; the numbers behind the last three are counters."""


@pytest.mark.parametrize("case", NAMES.splitlines())
def test_usual_names(case):
    seconds, resolution, stem = case.split(maxsplit=2)
    stamp = stamp_from_name(stem)
    # a Unix time in float64 resolves 240 ns
    assert stamp.shown_s == pytest.approx(UNIX + float(seconds), abs=3e-7)
    assert stamp.resolution_s == pytest.approx(float(resolution))
    assert stamp.utc_offset_s is None


@pytest.mark.parametrize(
    ("stem", "offset_s"),
    [("20210512T083107Z", 0.0), ("20210512T103107.123+0200", 7200.0), ("2021-05-12T10-31-07+02-00", 7200.0)],
)
def test_zones_in_names(tmp_path, stem, offset_s):
    assert stamp_from_name(stem).utc_offset_s == offset_s
    photo(tmp_path / f"{stem}.jpg")
    found = read_image_stamps(tmp_path, utc_offset="+05:00")
    assert np.floor(found.table["t_device_s"][0]) == T0


@pytest.mark.parametrize(
    "stem", ["IMG_0042", "20211312_083107", "P1000123", "20210512_253107", "boat", "2021"]
)
def test_names_without_a_time(stem):
    assert stamp_from_name(stem) is None


@pytest.mark.parametrize("when", [None, "2021:05:12 08:31:07"])
def test_digits_that_count_the_images_are_no_fraction(tmp_path, when):
    for k in range(4):
        photo(tmp_path / f"dji_fly_20210512_0831{7 + 3 * k:02d}_{100 + k}_photo.jpg", when)
    found = read_image_stamps(tmp_path, source="name")
    assert found.table["t_device_s"].tolist() == [T0, T0 + 3, T0 + 6, T0 + 9]
    assert noted(found, "Three digits behind the second count the images")


def test_times_of_the_last_change_are_told(tmp_path):
    exif = Image.Exif()
    exif[0x0132] = "2021:05:20 12:00:00"
    Image.new("RGB", (8, 8)).save(tmp_path / "a.jpg", exif=exif)
    notes = read_image_stamps(tmp_path).report.notes
    assert any("1 stamps are of the last change of the file (EXIF DateTime)" in note for note in notes)
    photo(tmp_path / "a.jpg", "2021:05:12 08:31:07")
    assert not noted(read_image_stamps(tmp_path), "last change")


@pytest.mark.parametrize(
    ("clock", "date", "words"),
    [
        (10, "2021:05:12", "+7200 s from the times of GPS (UTC) in EXIF (+2:00 h: a time zone)"),
        (8, "2021:05:12", ""),
        (10, "", ""),
    ],
)
def test_local_time_is_seen_beside_the_time_of_gps(tmp_path, clock, date, words):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x9003] = f"2021:05:12 {clock:02d}:31:07"
    exif.get_ifd(0x8825)[0x001D], exif.get_ifd(0x8825)[0x0007] = date, (8.0, 31.0, 6.5)
    Image.new("RGB", (8, 8)).save(tmp_path / "a.jpg", exif=exif)
    notes = " ".join(read_image_stamps(tmp_path).report.notes)
    assert words in notes
    assert ("times of GPS" in notes) == bool(words)


def test_a_clock_that_was_not_set_is_told(tmp_path):
    photo(tmp_path / "a.jpg", "1998:01:01 00:00:07")
    notes = read_image_stamps(tmp_path).report.notes
    assert any("first time is 1998-01-01. Was the clock of the camera set?" in note for note in notes)


def test_a_pattern_of_the_user():
    stamp = stamp_from_name("boat 12.05.2021 08h31m07,5", "*%d.%m.%Y %Hh%Mm%S,%f")
    assert (stamp.shown_s, stamp.resolution_s) == (UNIX + 0.5, 0.1)
    assert stamp_from_name("IMG_20210512_083107", "X%Y%m%d%H%M%S") is None


@pytest.mark.parametrize(
    ("pattern", "word"), [("%H%M%S", "no full time"), ("%Y%Q", "'%Q'"), ("%Y%Y%m%d%H%M%S", "twice")]
)
def test_unusable_patterns_are_told(pattern, word):
    with pytest.raises(InputError, match=word):
        compile_pattern(pattern)


def test_exif_with_sub_seconds_and_zone(tmp_path):
    head = read_head(photo(tmp_path / "a.jpg", "2021:05:12 10:31:07", "025", "+02:00"))
    stamp = {"second_s": UNIX + 7200, "fraction_s": 0.025, "resolution_s": 1e-3, "utc_offset_s": 7200.0}
    assert head.stamp == CivilStamp(**stamp)
    camera = (head.width, head.height, head.make, head.model, head.focal_mm)
    assert camera == (32, 24, "Panasonic", "DMC-GX80", 14.0)


@pytest.mark.parametrize(
    "when", [None, "0000:00:00 00:00:00", "    :  :     :  :  ", "2021:02:30 08:00:00", "1970:01:01 00:00:00"]
)
def test_exif_dates_that_are_none(when):
    assert stamp_from_exif(when) is None


def test_an_absent_sub_second_is_a_resolution_of_a_second():
    stamp = stamp_from_exif("2021:05:12 08:31:07", "  ")
    assert stamp.resolution_s == 1.0
    assert offset_seconds("+99:00") is None


def test_a_folder_of_names_in_ms(tmp_path):
    for k in range(5):
        photo(
            tmp_path / f"R20210512_0831{7 + k:02d}{100 + k}.jpg",
            f"2021:05:12 08:31:{7 + k:02d}",
            f"{100 + k}",
            "+00:00",
        )
    found = read_image_stamps(tmp_path)
    expected = T0 + np.arange(5) + 0.1 + 0.001 * np.arange(5)
    # 3e-7 s: a Unix time in float64
    assert_allclose(found.table["t_device_s"], expected, atol=3e-7)
    assert set(found.table["source"]) == {"name"}
    assert found.report.clean
    assert found.report.model == "Panasonic DMC-GX80"
    assert found.report.timing.resolution_s == pytest.approx(1e-3)
    write_table(tmp_path / "stamps.parquet", found.table, IMAGE_STAMPS)
    again, _ = read_table(tmp_path / "stamps.parquet", IMAGE_STAMPS)
    assert again["file"].tolist() == found.table["file"].tolist()


def test_exif_wins_where_names_hold_whole_seconds_only(tmp_path):
    photo(tmp_path / "20210512_083107.jpg", "2021:05:12 08:31:07", "25")
    found = read_image_stamps(tmp_path)
    assert found.table["source"].tolist() == ["exif"]
    assert found.table["t_device_s"][0] == pytest.approx(T0 + 0.25, abs=3e-7)


def test_local_time_needs_its_offset(tmp_path):
    photo(tmp_path / "a.jpg", "2021:05:12 10:31:07", "0")
    as_utc, as_local = (read_image_stamps(tmp_path, utc_offset=zone) for zone in (None, "+02:00"))
    assert as_utc.table["t_device_s"][0] - as_local.table["t_device_s"][0] == 7200.0
    assert noted(as_utc, "read as UTC")
    with pytest.raises(InputError, match="no offset"):
        read_image_stamps(tmp_path, utc_offset="summer")


def test_names_in_local_time_against_exif_in_utc_are_named_not_corrected(tmp_path):
    for k in range(3):
        photo(tmp_path / f"IMG_20210512_10310{k}_500.jpg", f"2021:05:12 08:31:0{k}", "500", "+00:00")
    found = read_image_stamps(tmp_path)
    (note,) = [note for note in found.report.notes if "+2:00 h: a time zone" in note]
    assert "those of the names are used" in note
    assert found.table["t_device_s"][0] == pytest.approx(T0 - 7 + 7200.5, abs=3e-7)


def test_what_is_missing_double_or_out_of_order_is_named(tmp_path, saved):
    Image.new("RGB", (8, 8)).save(tmp_path / "IMG_2.jpg")  # no time
    saved("IMG_3.jpg", b"not an image")
    saved("IMG_4.jpg", b"")
    for name, second in (("IMG_5", 9), ("IMG_6", 7), ("IMG_10", 8), ("IMG_11", 8)):
        photo(tmp_path / f"{name}.jpg", f"2021:05:12 08:31:{second:02d}")
    found = read_image_stamps(tmp_path)
    losses = "images_without_time images_unreadable repeated_stamps steps_back\n 3 2 1 1"
    assert found.report.losses == numbers(losses).iloc[0].to_dict()
    text = " ".join(found.report.notes)
    for name in ("IMG_2.jpg", "IMG_3.jpg", "IMG_4.jpg", "IMG_6.jpg", "IMG_11.jpg"):
        assert name in text
    assert found.table["file"].tolist() == [f"IMG_{k}.jpg" for k in (6, 10, 11, 5, 2, 3, 4)]
    assert np.isnan(found.table["t_device_s"].to_numpy()[-3:]).all()


def test_mixed_sources_are_counted(tmp_path):
    photo(tmp_path / "R20210512_083107000.jpg")
    photo(tmp_path / "retake.jpg", "2021:05:12 08:31:09", "000")
    found = read_image_stamps(tmp_path)
    assert found.report.counts["times_from_name"] == found.report.counts["times_from_exif"] == 1
    assert noted(found, "mixed sources: 1 from name, 1 from exif")


def test_a_hole_is_a_gap_with_the_number_of_images(tmp_path):
    for k in (0, 1, 2, 3, 7, 8):
        photo(tmp_path / f"R20210512_08310{k}000.jpg")
    (gap,) = read_image_stamps(tmp_path).report.gaps
    assert (gap.duration_s, gap.lost) == (4.0, 3)


CELLS = """\
unix_s   0.25  0.01  0    1620808267.25
unix_s   0.75  0.01  0    1620808267,75
unix_s   0     1     0    1620808267
unix_s   0.123 1e-6  0    1.620808267123000000e+09
t_gps_s  0.5   0.1   0    304843485.5
time_utc 0.125 0.001 7200 2021-05-12T08:31:07.125+02:00
"""
"""Column, fraction of the second 2021-05-12T08:31:07, resolution, offset from UTC, and what is written."""


@pytest.mark.parametrize("case", CELLS.splitlines())
def test_a_time_of_a_table_by_hand(case):
    form, *expected, text = case.split()
    found = _stamp(text, form, "a")
    stamp = (found.second_s, found.fraction_s, found.resolution_s, found.utc_offset_s)
    assert stamp == pytest.approx((UNIX, *map(float, expected)), abs=3e-7)


def test_a_time_without_seconds_is_told_to_the_minute():
    assert _stamp("2021-05-12T08:31Z", "time_utc", "a").resolution_s == 60.0


def test_a_table_of_times(tmp_path, saved):
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        photo(tmp_path / name)
    saved(
        "times.csv",
        "file,time_utc\na.jpg,2021-05-12T08:31:07.125Z\nb.jpg,2021-05-12T10:31:08.5+02:00\nd.jpg,2021-05-12T08:31:09Z\n",
    )
    found = read_image_stamps(list_images(tmp_path), times=tmp_path / "times.csv")
    assert_allclose(found.table["t_device_s"][:2], [T0 + 0.125, T0 + 1.5], atol=3e-7)
    assert found.report.losses == {"table_rows_without_image": 1, "images_without_time": 1}


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("name,time\na,1\n", "columns"),
        ("file,unix_s\na.jpg,x\n", "no time"),
        ("file,unix_s\na.jpg,12\n", "no date of a survey"),
        ("file,time_utc\na.jpg,2021-05-12\n", "no time"),
        ("file,time_utc\na.jpg,2021-05-12T08:31.5\n", "no time"),  # half a minute
        ("file,unix_s\na.jpg,1620808267\na.jpg,1620808268\n", "twice"),
        ("file,unix_s\n,1620808267\n", "without file name"),
    ],
)
def test_unusable_tables_are_told_with_their_line(tmp_path, saved, text, word):
    saved("t.csv", text)
    with pytest.raises(InputError, match=word):
        read_time_table(tmp_path / "t.csv")


def test_no_time_at_all_ends_with_a_cure(tmp_path):
    Image.new("RGB", (8, 8)).save(tmp_path / "a.jpg")
    with pytest.raises(ClockError, match=r"none of 1 images has a time.*pattern"):
        read_image_stamps(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        read_image_stamps(tmp_path / "absent")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no photograph"):
        read_image_stamps(tmp_path / "empty")


def test_damaged_exif_is_read_as_far_as_it_goes(tmp_path, saved):
    whole = photo(tmp_path / "R20210512_083107000.jpg", "2021:05:12 08:31:07", "5").read_bytes()
    rng = np.random.default_rng(1)
    for k in range(40):
        data = bytearray(whole)
        for place in rng.integers(20, 200, 6):
            data[place] = int(rng.integers(256))
        saved(f"R20210512_0832{k:02d}000.jpg", bytes(data))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read_image_stamps(tmp_path)
    # the names hold the time: a damaged head costs size and camera, not the image
    assert len(found.table) == 41
    assert np.isfinite(found.table["t_device_s"]).all()


SHIFTS = """\
3600.2 +1:00 h
-19800.0 -5:30 h
18.0 leap seconds
-17.6 leap seconds
86400.0 +1 day(s)
90000.0 +1 day(s) and +1:00 h
3.0 leap seconds that one
619315200.2 +1024 weeks
-1238637600.0 -2048 weeks: the week counter of a receiver rolled over; -2:00 h
"""


@pytest.mark.parametrize("case", SHIFTS.splitlines())
def test_shifts_are_named(case):
    shift, words = case.split(maxsplit=1)
    assert words in explain_shift(float(shift))


@pytest.mark.parametrize("shift", [3.2, 700.0, 2.3, 0.0])
def test_other_shifts_are_of_a_clock(shift):
    assert explain_shift(shift) == ""
