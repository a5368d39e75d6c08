"""RTKLIB .pos files: every variant that the engine itself writes, and damaged ones."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pyproj import Transformer

from tests.ingest.writers import noted, numbers
from thalweg.core import InputError, gps_from_week, write_table
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.registry import choose_tracks
from thalweg.ingest.tracks import read_pos

HEAD = (
    "% program   : RTKLIB\n% ref pos   :  50.000000000   13.000000000   200.0000\n%\n"
    "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix)\n"
    "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"
    "  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio\n"
)
LINE = (
    "2017/05/12 18:45:13.400   50.000000000   13.000000000   200.0000   1  11   0.0030   0.0020   0.0060"
    "  -0.0010   0.0015  -0.0025   0.40   12.3\n"
)
TO_ECEF = Transformer.from_crs(4979, 4978, always_xy=True)

RUN = """
import calendar, sys, pyrtklib5 as r
conf, folder, *files = sys.argv[1:]
variants = dict(
    base={}, tow={"out-timeform": "tow"}, utc={"out-timesys": "utc"}, jst={"out-timesys": "jst"},
    utctow={"out-timesys": "utc", "out-timeform": "tow"}, dms={"out-degform": "dms"},
    xyz={"out-solformat": "xyz"}, enu={"out-solformat": "enu"}, geodetic={"out-height": "geodetic"},
    comma={"out-fieldsep": ","}, tab={"out-fieldsep": "\\\\t"}, bare={"out-outhead": "off"},
    velocity={"out-outvel": "on"}, dmscomma={"out-degform": "dms", "out-fieldsep": ";"},
    enudms={"out-solformat": "enu", "out-degform": "dms"},
)
text = open(conf).read()
for name, options in variants.items():
    lines = [l for l in text.splitlines() if l.split("=")[0].strip() not in options]
    open(folder + "/o.conf", "w").write("\\n".join(lines + [f"{k}={v}" for k, v in options.items()]) + "\\n")
    r.resetsysopts()
    assert r.loadopts(folder + "/o.conf", r.sysopts.ptr) == 1
    p, s, f, a, b = r.prcopt_t(), r.solopt_t(), r.filopt_t(), r.gtime_t(), r.gtime_t()
    r.getsysopts(p, s, f)
    # the first minute tells how a variant is written
    a.time, b.time = 0, 0 if name == "base" else calendar.timegm((2021, 9, 22, 6, 30, 59))
    r.postpos(a, b, 0.0, 0.0, p, s, f, files, len(files), f"{folder}/{name}.pos", "", "")
"""


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.fixture
def read(tmp_path):
    """Reads a solution from its text."""
    return lambda text: read_pos([write(tmp_path / "text.pos", text)])


@pytest.fixture(scope="module")
def variants(data_dir, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pos")
    drive = data_dir / "rinex_cssrlib_kinematic_2021"
    files = [str(drive / name) for name in ("SEPT265G.21O", "3034265G.21O", "SEPT2650.21P")]
    conf = str(data_dir / "tools" / "ppk_cssrlib_demo5.conf")
    # a process of its own: the engine keeps its options in global memory
    subprocess.run([sys.executable, "-c", RUN, conf, str(folder), *files], check=True, capture_output=True)
    return folder


@pytest.mark.real
def test_real_drive_has_the_published_figures(variants):
    log = read_pos([variants / "base.pos"])
    fix = log.positions["fix"].value_counts()
    # PROVENANCE.md of the recording: Q1 348, Q2 12
    assert dict(fix) == {"fixed": 348, "float": 12}
    assert log.report.losses == {}
    start = log.positions[log.positions["fix"] == "fixed"].iloc[0]
    # PROVENANCE.md, first fixed epoch: start 35.342058031 139.521986442 47.5632
    assert (start["lat_deg"], start["lon_deg"]) == (35.342058031, 139.521986442)
    assert start["h_ell_m"] == 47.5632
    # 2021-09-22 06:30:00 GPST is week 2176, second 282600
    assert log.report.t_first_s == float(gps_from_week(2176, 282600.0))
    assert log.report.rates_hz["positions"] == pytest.approx(1.0)


@pytest.mark.real
@pytest.mark.parametrize(
    "name",
    [
        *("tow", "utc", "jst", "utctow", "dms", "xyz", "enu", "geodetic"),
        *("comma", "tab", "bare", "velocity", "dmscomma", "enudms"),
    ],
)
def test_all_variants_of_one_solution_agree(variants, name):
    base = read_pos([variants / "base.pos"]).positions.iloc[:60]
    log = read_pos([variants / f"{name}.pos"])
    other = log.positions
    assert len(other) == len(base)
    # times have 3 digits
    assert_allclose(other["t_gps_s"], base["t_gps_s"], atol=1e-6)
    assert list(other["fix"]) == list(base["fix"])
    for column in ("n_sats", "age_s", "ratio"):
        assert_array_equal(other[column], base[column])
    if name == "geodetic":
        assert other["h_ell_m"].isna().all()
        assert noted(log, "geoid")
        other = other.assign(h_ell_m=base["h_ell_m"])
    position, expected = (
        np.stack(TO_ECEF.transform(f["lon_deg"], f["lat_deg"], f["h_ell_m"])).T for f in (other, base)
    )
    # 1e-9 deg = 0.11 mm, 1e-5" = 0.3 mm, x/y/z and baselines 0.05 mm; the reference position of a
    # baseline is itself rounded to 1e-9 deg: twice the largest of these.
    assert_allclose(position, expected, atol=6e-4)
    sigma = [f[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy() for f in (other, base)]
    largest = sigma[1].max(axis=1)
    # Each number r is a root rounded by 5e-5, so r^2 is off by 1e-4 r at most; a rotation sums 9 of them, and
    # in x, y, z each may be as large as the largest sigma. The signed roots of covariances count double.
    bound = 1e-3 * largest + 1e-7
    difference = [np.abs(sigma[0] ** 2 - sigma[1] ** 2).T]
    difference.append(np.abs(np.stack([other[c] - base[c] for c in ("cov_en_m2", "cov_eu_m2", "cov_nu_m2")])))
    assert np.all(np.concatenate(difference) <= bound)


def test_covariance_of_earth_centred_coordinates_is_rotated(read):
    head = "%  GPST x-ecef y-ecef z-ecef Q ns sdx(m) sdy(m) sdz(m) sdxy(m) sdyz(m) sdzx(m) age(s) ratio\n"
    # On the equator at longitude 90 deg: up is y, east is -x, north is z.
    line = "1948 499513.400 0.0 6378137.0 0.0 2 9 0.01 0.02 0.03 0.004 0.005 -0.006 1.0 2.0\n"
    row = read(head + line).positions.iloc[0]
    assert row["lat_deg"] == pytest.approx(0.0, abs=1e-12)
    assert row["lon_deg"] == pytest.approx(90.0)
    sigmas = row[["sigma_east_m", "sigma_up_m", "sigma_north_m"]].to_numpy(dtype=float)
    assert_allclose(sigmas, [0.01, 0.02, 0.03], rtol=1e-12)
    assert row["cov_eu_m2"] == pytest.approx(-(0.004**2))
    assert row["cov_nu_m2"] == pytest.approx(0.005**2)
    assert row["cov_en_m2"] == pytest.approx(0.006**2)


@pytest.mark.parametrize(
    ("stamp", "second", "gps_week_second"),
    [
        ("%  UTC", "60.400", (1930, 17.4 + 0)),  # 2017-01-01T00:00:00 UTC is second 18 of the week
        ("%  GPST", "59.400", (1929, 604799.4)),
        ("%  GPST", "60.000", (1930, 0.0)),  # rounded up: no leap second
    ],
)
def test_leap_second_stamp(read, stamp, second, gps_week_second):
    text = HEAD.replace("%  GPST", stamp) + LINE.replace(
        "2017/05/12 18:45:13.400", f"2016/12/31 23:59:{second}"
    )
    t = read(text).positions["t_gps_s"][0]
    # float64 resolves 30 ns here
    assert t == pytest.approx(float(gps_from_week(*gps_week_second)), abs=1e-7)


def test_signs_of_degrees_minutes_seconds(read):
    head = HEAD.replace("latitude(deg) longitude(deg)", "latitude(d'\") longitude(d'\")")
    line = LINE.replace("50.000000000   13.000000000", "  -0 30 00.00000   -70 15 36.00000")
    row = read(head + line).positions.iloc[0]
    assert (row["lat_deg"], row["lon_deg"]) == pytest.approx((-0.5, -70.26))


def test_all_qualities(tmp_path, read):
    lines = [
        LINE.replace("18:45:13", f"18:45:{13 + q}").replace("   1  11", f"   {q}  11") for q in range(1, 8)
    ]
    log = read(HEAD + "".join(lines))
    expected = ["fixed", "float", "sbas", "dgnss", "single", "ppp", "dead_reckoning"]
    assert list(log.positions["fix"]) == expected
    write_table(tmp_path / "a.parquet", log.positions, GNSS_POSITION)


def test_damaged_lines_are_counted_with_their_numbers(read):
    wrong = {"50.0": "5x.0", "/05/": "/13/", "18:45": "25:45", "   1  11": "   9  11", " 50.0": " 150.0"}
    damaged = [LINE[:60] + "\n", "\x00\x01rubbish\n", *(LINE.replace(*each) for each in wrong.items())]
    text = HEAD + LINE + "".join(damaged) + LINE.replace("13.400", "13.600")
    text += LINE.replace("13.400", "13.800")[:90]
    log = read(text)
    assert len(log.positions) == 2
    assert log.report.losses == {"damaged_lines": 8}
    assert "7, 8, 9, 10, 11, 12, 13, 15" in log.report.details["damaged_lines"].values()


def test_gaps_steps_back_and_several_files(tmp_path):
    lines = [LINE.replace("13.400", f"{s:06.3f}") for s in (10.0, 10.2, 10.4, 10.6, 12.0, 12.2, 12.2, 12.4)]
    first = write(tmp_path / "a.pos", HEAD + "".join(lines))
    second = write(
        tmp_path / "b.pos", HEAD.replace("%  GPST", "%  UTC") + LINE.replace("18:45:13", "18:44:50")
    )
    log = read_pos([first, second])
    assert log.report.counts["positions"] == 9
    assert log.report.losses == {"time_steps_back": 1, "repeated_times": 1}
    assert [gap.lost for gap in log.report.gaps] == [6]
    assert "UTC" in log.report.lines()[3]


def test_missing_header_is_said(read):
    log = read(LINE)
    assert log.positions["lat_deg"][0] == 50.0
    assert noted(log, "taken as latitude")


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        ("", "the file is empty"),
        (HEAD, "only a header"),
        ("$GPGGA,123519,4807.038,N*47\n", "none of 1 lines is a position"),
        ("\x89PNG\r\n\x1a\n" * 40, "none of"),
        (HEAD + LINE[:70], "line 6"),
        (HEAD + LINE.replace(".", ","), "decimal commas: write points"),
        (
            HEAD + LINE.replace("2017/05/12 18:45:13.400", "499513.400"),
            "seconds of a week without their week",
        ),
        (
            HEAD.replace(
                "latitude(deg) longitude(deg)  height(m)", "e-baseline n-baseline u-baseline"
            ).replace("ref pos", "unk pos")
            + LINE,
            "without the position of its base",
        ),
        (
            HEAD.replace(
                "latitude(deg) longitude(deg)  height(m)", "e-baseline n-baseline u-baseline"
            ).replace("50.000000000   13.000000000   200.0000", "0.0 0.0 0.0")
            + LINE,
            r"without the position of its base \(ref pos '0.0 0.0 0.0'",
        ),
    ],
)
def test_bad_input_has_a_message(read, text, fragment):
    with pytest.raises(InputError, match=fragment) as caught:
        read(text)
    assert "text.pos" in str(caught.value)
    with pytest.raises(InputError, match="file not found"):
        read_pos([Path("nowhere.pos")])


def test_files_that_overlap_are_joined(tmp_path, read):
    def lines(first, last, lat="50.000000000"):
        return HEAD + "".join(
            LINE.replace("13.400", f"{k:02d}.000").replace("50.000000000", lat, 1) for k in range(first, last)
        )

    a, b = write(tmp_path / "a.pos", lines(0, 30)), write(tmp_path / "b.pos", lines(20, 50))
    log, whole = read_pos([a, b]), read(lines(0, 50))
    pd.testing.assert_frame_equal(log.positions, whole.positions)
    assert log.report.clean
    assert log.report.counts["repeated_positions_dropped"] == 10
    assert log.report.counts["positions"] == log.report.counts["fix_fixed"] == 50
    assert noted(log, "10 positions that occur in two of them")
    assert "repeated_positions_dropped" not in whole.report.counts
    # the same times with other positions are two solutions: nothing is dropped, and it is told
    other = read_pos([a, write(tmp_path / "c.pos", lines(20, 50, "50.000000001"))])
    assert len(other.positions) == 60
    assert other.report.losses == {"time_steps_back": 1}


def test_every_column_of_the_positions_by_hand(tmp_path, read):
    """From a line of RTKLIB to the file, read with pyarrow alone: names, units and numbers."""
    positions = read(HEAD + LINE).positions
    write_table(tmp_path / "positions.parquet", positions, GNSS_POSITION)
    table = pq.read_table(tmp_path / "positions.parquet")
    # RTKLIB writes roots of covariances with the covariance's sign, and -1 mm for north-east
    expected = numbers("""
        name          value   unit
        lat_deg        50.0    deg
        lon_deg        13.0    deg
        h_ell_m       200.0    m
        n_sats         11      1
        sigma_east_m    0.002  m
        sigma_north_m   0.003  m
        sigma_up_m      0.006  m
        cov_en_m2   -1e-6      m^2
        cov_eu_m2    2.25e-6   m^2
        cov_nu_m2   -6.25e-6   m^2
        age_s           0.4    s
        ratio          12.3    1
    """).set_index("name")
    found = table.to_pylist()[0]
    assert found.pop("fix") == "fixed"
    # GPS week 1948 begins on 7 May 2017; 5 days, 18:45:13.4; LAS takes 1e9 off
    assert found.pop("t_gps_s") == pytest.approx(1948 * 604800 + 5 * 86400 + 67513.4 - 1e9)
    assert found == pytest.approx(expected["value"].to_dict())
    units = {field.name: field.metadata[b"unit"].decode() for field in table.schema}
    assert units == {"t_gps_s": "s", "fix": "1"} | expected["unit"].to_dict()


def epochs(first: float, n: int, scale: str = "GPST", step_s: float = 1.0) -> str:
    """A solution of ``n`` epochs from a second of 10:00, moving 1e-6 deg a second north."""
    lines = [HEAD.replace("GPST", scale)]
    for k in range(n):
        t = first + k * step_s
        clock = f"2024/06/12 10:{int(t) // 60:02d}:{t % 60:06.3f}"
        lines.append(LINE.replace("2017/05/12 18:45:13.400   50.000000000", f"{clock}   {50 + t * 1e-6:.9f}"))
    return "".join(lines)


def test_each_solution_of_a_joined_file_keeps_its_own_scale_and_columns(read):
    velocity = epochs(180, 5).replace("ratio\n", "ratio   vn(m/s)   ve(m/s)   vu(m/s)\n")
    velocity = velocity.replace("12.3\n", "12.3   0.1   0.2   0.3\n")
    text = epochs(18, 60) + epochs(120, 60, "UTC") + velocity
    log = read(text)
    t = log.positions["t_gps_s"].to_numpy()
    # 10:02:00 UTC is 18 s behind 10:02:00 GPST; the last one is in GPST again
    assert t[60] - t[0] == 120.0
    assert t[120] - t[0] == 162.0
    assert log.report.losses == {"time_steps_back": 1}
    assert noted(log, "GPS from line 6 on, UTC from line 71 on")
    remark = epochs(0, 3) + "% a remark of somebody\n" + epochs(3, 3)[len(HEAD) :]
    assert len(read(remark).positions) == 6


def test_each_baseline_keeps_the_base_of_its_own_header(read):
    head = HEAD.replace(
        "latitude(deg) longitude(deg)  height(m)", "e-baseline(m) n-baseline(m) u-baseline(m)"
    )
    line = LINE.replace("50.000000000   13.000000000   200.0000", "0.0000   0.0000   0.0000")
    both = (
        head + line + head.replace("50.000000000   13", "51.000000000   14") + line.replace(":13.4", ":14.4")
    )
    table = read(both).positions
    assert_allclose(table["lat_deg"], [50.0, 51.0], atol=1e-9)


def test_two_solutions_of_one_time_are_no_track(tmp_path):
    fixed = write(tmp_path / "fixed.pos", epochs(0, 10))
    single = write(tmp_path / "single.pos", epochs(0, 10).replace("13.000000000", "13.000001000"))
    with pytest.raises(InputError, match=r"10 epochs have other positions in single\.pos than in fixed\.pos"):
        read_pos([fixed, single])


@pytest.mark.parametrize("name", ["rover_events.pos", "camera.pos"])
def test_times_of_events_are_no_part_of_the_track(tmp_path, name):
    track = write(tmp_path / "rover.pos", epochs(0, 60))
    events = write(tmp_path / name, epochs(5.372, 5, step_s=10.0))
    log = read_pos([track, events])
    assert len(log.positions) == 60
    assert log.report.losses == {"event_marks": 5}
    assert choose_tracks([track, events])[0] == [track]
    # positions between the epochs that no line leads to are a second receiver's, and stay
    other = write(tmp_path / "second.pos", events.read_text().replace("13.000000000", "13.000000300"))
    assert len(read_pos([track, other]).positions) == 65


@pytest.mark.parametrize(
    ("usual", "stated", "words"),
    [
        ("height(m)", "height(ft)", r"height\(ft\)"),
        (
            "latitude(deg) longitude(deg)",
            "longitude(deg) latitude(deg)",
            r"columns longitude\(deg\) latitude",
        ),
        ("latitude(deg) longitude(deg)", "latitude(rad) longitude(rad)", r"latitude\(rad\)"),
    ],
)
def test_other_units_and_orders_are_refused(read, usual, stated, words):
    with pytest.raises(InputError, match=words):
        read(HEAD.replace(usual, stated) + LINE)


def test_other_datums_and_heights_are_told(read):
    log = read(HEAD.replace("WGS84/ell", "Tokyo/ell") + LINE)
    assert noted(log, "states the datum Tokyo")
    log = read(HEAD.replace("/ellipsoidal", "/orthometric") + LINE)
    assert log.positions["h_ell_m"].isna().all()


@pytest.mark.parametrize("head", [HEAD, ""])
def test_standard_deviations_of_0_throughout_are_unknown(read, head):
    """Programs that know none fill the columns so; a single 0 is the noise of the engine's covariance."""
    zeros = LINE.replace("   0.0030   0.0020   0.0060  -0.0010   0.0015  -0.0025", "   0.0000" * 6)
    log = read(head + zeros + zeros.replace("13.400", "13.600"))
    assert log.positions[["sigma_east_m", "sigma_up_m", "cov_en_m2"]].isna().all(axis=None)
    assert noted(log, "All standard deviations are 0: taken as unknown.")
    log = read(head + zeros + LINE.replace("13.400", "13.600"))
    assert log.positions["sigma_north_m"].tolist() == pytest.approx([0.0, 0.003], abs=1e-12)
