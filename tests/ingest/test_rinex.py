"""RINEX scanner: figures of real and synthetic files, damage, fuzz."""

import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from tests.ingest.writers import noted
from thalweg.core import InputError, ThalwegError, UnsupportedError, utc_text_from_gps
from thalweg.core.timescales import LeapSecondWarning
from thalweg.ingest.ppk import describe_rinex
from thalweg.ingest.ppk.rinex import scan_rinex, whole_records


def line(text: str, label: str) -> str:
    return f"{text:60s}{label}\n"


def obs_3(
    n_epochs: int = 5,
    *,
    satellites: tuple[str, ...] = ("G05", "G08", "E11"),
    first_s: int = 0,
    day: int = 12,
    position: str = " -2706105.2018 -4261210.8062  3885598.6411",
    version: str = "     3.04",
    scale: str = "GPS",
) -> str:
    head = [
        line(f"{version:20s}{'OBSERVATION DATA':20s}M", "RINEX VERSION / TYPE"),
        line("MARK", "MARKER NAME"),
        line(f"{'4711':20s}{'TESTREC':20s}1.0", "REC # / TYPE / VERS"),
        line(f"{'1':20s}TESTANT", "ANT # / TYPE"),
        line(position, "APPROX POSITION XYZ"),
        line("        0.1000        0.0000        0.0000", "ANTENNA: DELTA H/E/N"),
        line("G    4 C1C L1C C2S L2S", "SYS / # / OBS TYPES"),
        line("E    2 C1C L1C", "SYS / # / OBS TYPES"),
        line(f"  2017    05    {day:02d}    18    45   14.0000000     {scale}", "TIME OF FIRST OBS"),
        line("", "END OF HEADER"),
    ]
    for k in range(first_s, first_s + n_epochs):
        minute, second = divmod(45 * 60 + 14 + k, 60)
        head.append(f"> 2017 05 {day:02d} 18 {minute:02d} {second:2d}.0000000  0{len(satellites):3d}\n")
        head += [f"{s}{23870514.32 + k:14.3f}  {125440402.25 + k:14.3f} 7\n" for s in satellites]
    return "".join(head)


def obs_2(n_epochs: int = 3, n_sat: int = 14) -> str:
    """RINEX 2.11 with seven codes (two lines a satellite) and more than 12 satellites (two list lines)."""
    text = line(f"{'     2.11':20s}{'OBSERVATION DATA':20s}G (GPS)", "RINEX VERSION / TYPE")
    text += line("     7    C1    L1    D1    S1    P2    L2    S2", "# / TYPES OF OBSERV")
    text += line("", "END OF HEADER")
    names = [f"G{k:2d}" for k in range(1, n_sat + 1)]
    for k in range(n_epochs):
        text += f" 17  5 12 18 45 {14 + k:2d}.0000000  0{n_sat:3d}{''.join(names[:12])}\n"
        if n_sat > 12:
            text += " " * 32 + "".join(names[12:]) + "\n"
        for _ in names:
            text += "".join(f"{20000000.0 + k:14.3f}  " for _ in range(5)) + "\n"
            text += f"{20000000.0:14.3f}  {48.0:14.3f}  \n"
    return text


def nav_3(systems: str = "GG", *, day: int = 12, hour: int = 20) -> str:
    text = line(f"{'     3.04':20s}{'N: GNSS NAV DATA':20s}M", "RINEX VERSION / TYPE") + line(
        "", "END OF HEADER"
    )
    for k, letter in enumerate(systems):
        text += f"{letter}{k + 1:02d} 2017 05 {day:02d} {hour:02d} 00 00 -.4D-04  .1D-11  .0D+00\n"
        text += "      .480000000000D+02 -.8D+01  .5D-08  .2D+01\n" * (3 if letter in "RS" else 7)
    return text


def write(folder: Path, name: str, text: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(text.encode("latin-1") if isinstance(text, str) else text)
    return path


@pytest.mark.parametrize("version", ["     3.04", "     4.01"])
def test_observation_3_and_4(tmp_path, version):
    report = describe_rinex(write(tmp_path, "a.obs", obs_3(70, version=version)))
    assert report.counts == {"epochs": 70, "satellite records": 210}
    assert report.clean
    assert report.synchronised
    assert utc_text_from_gps(report.t_first_s) == "2017-05-12T18:44:56.000Z"  # GPS - UTC = 18 s
    assert report.t_last_s - report.t_first_s == 69.0
    assert report.rates_hz == {"epochs": 1.0}
    assert report.model == "TESTREC"
    words = {"systems": "GPS, GAL", "marker": "MARK", "antenna": "TESTANT"}
    assert words.items() <= report.details.items()
    assert report.details["approx_ecef_m"] == [-2706105.2018, -4261210.8062, 3885598.6411]
    assert report.details["antenna_delta_hen_m"] == [0.1, 0.0, 0.0]


def test_observation_2_with_continuation_lines(tmp_path):
    scan = scan_rinex(write(tmp_path, "a.17o", obs_2()))
    assert scan.version == "2.11"
    assert scan.systems == ("GPS",)
    assert np.array_equal(np.diff(scan.t_gps_s), [1.0, 1.0])
    assert scan.n_satellite_records == 42
    assert not scan.losses
    # a satellite without a letter is of the system of the file, in a mixed file of GPS
    for head, system in (("R (GLONASS)", "GLO"), ("M (MIXED)", "GPS"), ("E (GALILEO)", "GAL")):
        text = obs_2().replace("G (GPS)", head).replace("G", " ")
        assert scan_rinex(write(tmp_path, "b.17o", text)).systems == (system,)


def codes_2(n_codes, n_sat):
    """RINEX 2.11 with so many codes and satellites, in full lines; no line feed behind the last one."""
    text = line(f"{'     2.11':20s}{'OBSERVATION DATA':20s}G (GPS)", "RINEX VERSION / TYPE")
    names = [f"    {name}" for name in ("C1", "L1", "D1", "S1", "P2", "L2", "S2", "D2", "C5", "L5", "S5")]
    for k in range(0, n_codes, 9):
        label = f"{n_codes:6d}" if not k else " " * 6
        text += line(label + "".join(names[k : min(k + 9, n_codes)]), "# / TYPES OF OBSERV")
    text += line("", "END OF HEADER")
    satellites = [f"G{k:02d}" for k in range(1, n_sat + 1)]
    rows = [min(5, n_codes - k) for k in range(0, n_codes, 5)]
    for second in (14, 15):
        lists = ["".join(satellites[k : k + 12]) for k in range(0, n_sat, 12)]
        text += f" 17  5 12 18 45 {second:2d}.0000000  0{n_sat:3d}" + f"\n{'':32s}".join(lists) + "\n"
        text += "".join("".join(f"{2e7:14.3f}  " for _ in range(n)) + "\n" for _ in satellites for n in rows)
    return text[:-1]


@pytest.mark.parametrize("n_codes", [4, 5, 6, 10, 11])
@pytest.mark.parametrize("n_sat", [11, 12, 13, 24, 25])
def test_full_lines_of_version_2(tmp_path, n_codes, n_sat):
    """Five values and twelve satellites a line: no line more where the last one is full."""
    path = write(tmp_path, "a.17o", codes_2(n_codes, n_sat) + "\n")
    scan = scan_rinex(path)
    assert not scan.losses
    assert scan.n_satellite_records == 2 * n_sat
    assert len(scan.codes["G"]) == n_codes
    assert not scan.regular
    assert whole_records(scan, path.read_bytes()) == path.read_bytes()


@pytest.mark.parametrize(
    ("cut", "whole"),
    [
        (0, True),
        (2, True),
        (3, False),
        (15, False),
        (16, True),
        (18, True),
        (19, False),
        (50, True),
        (51, False),
    ],
)
def test_a_last_value_that_is_cut(tmp_path, cut, whole):
    """Four values of 14 columns, each with two of flags, in a last line without line feed."""
    text = codes_2(4, 2)
    for end in ("", "\r"):
        scan = scan_rinex(write(tmp_path, "a.17o", text[: len(text) - cut] + end))
        assert scan.losses == ({} if whole else {"epochs_cut": 1})
        assert len(scan.t_gps_s) == 1 + whole


@pytest.mark.parametrize(
    ("scale", "offset_s"), [("GPS", 0.0), ("GAL", 0.0), ("BDT", 14.0), ("BDS", 14.0), ("GLO", 18.0)]
)
def test_time_scales(tmp_path, scale, offset_s):
    gps = scan_rinex(write(tmp_path, "a.obs", obs_3(1))).t_gps_s
    other = scan_rinex(write(tmp_path, "b.obs", obs_3(1, scale=scale))).t_gps_s
    assert other[0] - gps[0] == offset_s


def test_navigation_systems_and_time(tmp_path):
    scan = scan_rinex(write(tmp_path, "a.nav", nav_3("GGREC")))
    assert {k: v.size for k, v in scan.nav_t_gps_s.items()} == {"GPS": 2, "GLO": 1, "GAL": 1, "BDS": 1}
    gps = scan.nav_t_gps_s["GPS"][0]
    assert scan.nav_t_gps_s["GLO"][0] - gps == 18.0  # UTC
    assert scan.nav_t_gps_s["BDS"][0] - gps == 14.0  # BDT
    report = describe_rinex(scan.path)
    assert report.counts == {"ephemerides": 5}
    assert report.details["GPS"] == (
        "2 ephemerides, reference times 2017-05-12T19:59:42Z .. 2017-05-12T19:59:42Z"
    )


def test_navigation_2(tmp_path):
    text = line(f"{'     2.11':20s}NAVIGATION DATA", "RINEX VERSION / TYPE") + line("", "END OF HEADER")
    text += " 5 17  5 12 20  0  0.0-.463202595711D-04 .17D-11 .0D+00\n" + "    .48D+02 -.8D+01\n" * 7
    scan = scan_rinex(write(tmp_path, "a.17n", text))
    assert scan.nav_t_gps_s["GPS"].size == 1
    assert utc_text_from_gps(float(scan.t_gps_s[0]), 0) == "2017-05-12T19:59:42Z"
    assert not scan.losses


@pytest.mark.parametrize(
    ("kind", "system", "utc_s"), [("GLONASS NAV DATA", "GLO", 18.0), ("H: GEO NAV MSG DATA", "SBS", 0.0)]
)
def test_navigation_2_of_one_system(tmp_path, kind, system, utc_s):
    """GLONASS and SBAS have three lines behind the head; times of GLONASS are UTC."""
    text = line(f"{'     2.11':20s}{kind}", "RINEX VERSION / TYPE") + line("", "END OF HEADER")
    text += " 5 99  5 12 20  0  0.0-.463202595711D-04 .17D-11 .0D+00\n" + "    .48D+02 -.8D+01\n" * 3
    scan = scan_rinex(write(tmp_path, "a.17g", text))
    (t_gps_s,) = scan.nav_t_gps_s[system]
    assert not scan.losses
    utc = utc_text_from_gps(float(t_gps_s), 0)
    # GPS - UTC was 13 s in 1999
    assert utc == ("1999-05-12T20:00:00Z" if utc_s else "1999-05-12T19:59:47Z")
    report = describe_rinex(scan.path)
    assert (report.t_first_s, report.t_last_s) == (t_gps_s, t_gps_s)


LINE_7 = "      .480000000000D+02 -.8D+01  .5D-08  .2D+01\n"


@pytest.mark.parametrize(
    ("change", "losses", "left"),
    [
        (lambda t: t, {}, "GRGS"),
        (lambda t: t.replace(LINE_7 + "G03", "G03"), {"ephemerides_cut": 1}, "GGS"),
        (lambda t: t.replace(LINE_7 + "R02", "R02"), {"ephemerides_cut": 1}, "RGS"),
        (lambda t: t.removesuffix(LINE_7), {"ephemerides_cut": 1}, "GRG"),
        (lambda t: t[:-1], {"ephemerides_cut": 1}, "GRG"),
        (lambda t: t + LINE_7[:-1], {}, "GRGS"),
        (lambda t: t.replace("R02 2017 05", "R02 2017 13"), {"ephemerides_garbled": 1}, "GGS"),
        (lambda t: t.replace("R02 2017 05", "R02 1979 05"), {"ephemerides_garbled": 1}, "GGS"),
        (lambda t: t.replace("R02 2017", "Q02 2017"), {"lines_unplaced": 4}, "GGS"),
        (lambda t: t.replace("R02", "rubbish\nR02"), {"lines_unplaced": 1}, "GRGS"),
    ],
)
def test_damage_of_ephemerides_is_local(tmp_path, change, losses, left):
    path = write(tmp_path, "a.nav", change(nav_3("GRGS")))
    scan = scan_rinex(path)
    assert scan.losses == losses
    assert "".join(scan.letters) == left
    assert not losses or scan.first_loss.startswith("line ")
    again = scan_rinex(write(tmp_path, "b.nav", whole_records(scan, path.read_bytes())))
    assert (again.letters, dict(again.losses)) == (scan.letters, {})


def test_navigation_4_skips_what_is_no_ephemeris(tmp_path):
    text = line(f"{'     4.00':20s}NAVIGATION DATA", "RINEX VERSION / TYPE") + line("", "END OF HEADER")
    text += "> ION G05 LNAV\n    2017 05 12 18 00 00 .1D-07\n"
    text += "> EPH G05 LNAV\nG05 2017 05 12 20 00 00-.4D-04 .1D-11 .0D+00\n" + "     .48D+02\n" * 7
    path = write(tmp_path, "a.rnx", text)
    scan = scan_rinex(path)
    assert scan.t_gps_s.size == 1
    assert not scan.losses
    assert whole_records(scan, path.read_bytes()).decode() == text


@pytest.mark.parametrize(
    ("change", "losses", "epochs_left"),
    [
        (lambda t: t[:-20], {"epochs_cut": 1}, 4),
        (lambda t: t.replace("45 16.0000000", "4x 16.0000000"), {"epochs_garbled": 1}, 4),
        (lambda t: t.replace("45 16.0000000  0  3", "45 16.0000000  0  9"), {"epochs_cut": 1}, 4),
        (lambda t: t.replace("45 16.0000000  0  3", "45 16.0000000  0  2"), {"lines_unplaced": 1}, 5),
        (lambda t: t.replace("23870516.320", "2387\x00516.320", 1), {"epochs_garbled": 1}, 4),
        (lambda t: t.replace("2017 05 12 18 45 16", "2017 13 12 18 45 16"), {"epochs_garbled": 1}, 4),
        (lambda t: t + "garbage\n", {"lines_unplaced": 1}, 5),
    ],
)
def test_damage_is_counted_and_the_rest_is_kept(tmp_path, change, losses, epochs_left):
    path = write(tmp_path, "a.obs", change(obs_3(5)))
    scan = scan_rinex(path)
    assert scan.losses == losses
    assert scan.t_gps_s.size == epochs_left
    clean = scan_rinex(write(tmp_path, "b.obs", whole_records(scan, path.read_bytes())))
    assert not clean.losses
    assert np.array_equal(clean.t_gps_s, scan.t_gps_s)
    assert noted(describe_rinex(path), "damaged or cut")


@pytest.mark.parametrize(
    ("old", "new", "losses", "left"),
    [
        ("45 15.0", "4x 15.0", {"lines_unplaced": 30}, [0, 2]),  # two head lines and 14 x 2 lines of values
        ("12 18 45 15.0", "12 28 45 15.0", {"epochs_garbled": 1}, [0, 2]),
        ("20000001.000", "2000000?.000", {"epochs_garbled": 1}, [0, 2]),
        (obs_2()[-150:], "", {"epochs_cut": 1}, [0, 1]),
    ],
    ids=["words", "hour", "value", "cut"],
)
def test_damage_of_version_2_is_local(tmp_path, old, new, losses, left):
    scan = scan_rinex(write(tmp_path, "a.17o", obs_2().replace(old, new, 1)))
    assert scan.losses == losses
    assert (scan.t_gps_s - scan.t_gps_s[0]).tolist() == left


def odd(old: str, new: str, text: str = obs_3(5)) -> str:
    """Five epochs whose epoch lines have a text in the place of another."""
    rows = text.splitlines(keepends=True)
    return "".join(row.replace(old, new) if row.startswith((">", " 17  5 12")) else row for row in rows)


def before(k: int, text: str, extra: str) -> str:
    """A text of five epochs with an extra record before epoch k."""
    mark = f" 18 45 {14 + k}.0"
    begin = text.rindex("\n", 0, text.index(mark)) + 1
    return text[:begin] + extra + text[begin:]


SLIPS = "> 2017 05 12 18 45 16.0000000  6  1\nG05         1.000           1.000\n"
ODD = {
    "one blank before the flag": odd("00  0", "00 0"),
    "three blanks before the flag": odd("00  0", "00   0"),
    "one blank behind the flag": odd("0  3\n", "0 3\n"),
    "no flag": odd("  0  3", "     3"),
    "no decimals": odd(".0000000  0", "  0"),
    "no decimals, in columns": odd(".0000000", " " * 8),
    "decimal comma": odd(".", ","),
    "no zeros": odd(" 05 ", " 5 "),
    "two digits of the year": odd(" 2017", " 17"),
    "clock offset": odd("  0  3\n", "  0  3      -0.000123456789\n"),
    "garbage behind the number": odd("  0  3\n", "  0  3    # ok\n"),
    "garbage behind the values": obs_3(5).replace(" 7\n", " 7" + " " * 32 + "~?\n"),
    "CR LF": obs_3(5).replace("\n", "\r\n"),
    "blank lines at the end": obs_3(5) + "\n\n",
    "power failure": obs_3(5).replace("16.0000000  0", "16.0000000  1"),
    "start of motion with observations": obs_3(5).replace("16.0000000  0", "16.0000000  2"),
    "start of motion": before(2, obs_3(5), f">{'':30s}2  1\n" + line("BOAT", "MARKER NAME")),
    "new site": before(2, obs_3(5), f">{'':30s}3  1\n" + line("BOAT", "MARKER NAME")),
    "header records": before(2, obs_3(5), f">{'':29s}4  1\n" + line("windy", "COMMENT")),
    "external event": before(2, obs_3(5), "> 2017 05 12 18 45 15.4000000  5  0\n"),
    "repaired cycle slips": before(2, obs_3(5), SLIPS),
    "2: one blank before the flag": odd("00  0", "00 0", obs_2(5)),
    "2: more blanks": odd("0 14G 1", "0   14  G 1", obs_2(5)),
    "2: list elsewhere": obs_2(5).replace("\n" + " " * 32 + "G13", "\n" + " " * 34 + "G13"),
    "2: no decimals": odd(".0000000  0", "  0", obs_2(5)),
    "2: CR LF": obs_2(5).replace("\n", "\r\n"),
    "2: BeiDou and QZSS": obs_2(5).replace("G 1G 2", "C01J02"),
    "2: start of motion": before(2, obs_2(5), f"{'':28s}2  1\n" + line("BOAT", "MARKER NAME")),
    "2: start of motion with observations": obs_2(5).replace("16.0000000  0", "16.0000000  2"),
    "2: event": before(2, obs_2(5), " 17  5 12 18 45 15.4000000  5  0\n"),
    "2: repaired cycle slips": before(
        2, obs_2(5), " 17  5 12 18 45 16.0000000  6  1G 1\n" + f"{1.0:14.3f}  {1.0:14.3f}\n" + "\n"
    ),
    "2: other codes from there on": obs_2(3)
    + f"{'':28s}4  1\n"
    + line("     1    C1", "# / TYPES OF OBSERV")
    + "".join(f" 17  5 12 18 45 {s}.0000000  0  2G 1G 2\n" + f"{2e7:14.3f}\n" * 2 for s in (17, 18)),
}
RTKLIB_EPOCHS = """
import sys, pyrtklib5 as r
for name in sys.argv[1:]:
    obs, nav, sta = r.obs_t(), r.nav_t(), r.sta_t()
    r.readrnx(name, 1, "", obs, nav, sta)
    rows = [obs.data[k] for k in range(obs.n)]
    print(*sorted({round(row.time.time % 60 + row.time.sec, 3) for row in rows}), len(rows))
"""


def test_epoch_lines_of_any_form(tmp_path):
    """Whatever RTKLIB reads is read, and what is passed on to it says the same to RTKLIB."""
    passed, raw = [], []
    for k, (name, text) in enumerate(ODD.items()):
        path = write(tmp_path, f"{k}.obs", text)
        scan = scan_rinex(path)
        assert not scan.losses, name
        assert scan.t_gps_s.tolist() == (scan.t_gps_s[0] + np.arange(5)).tolist(), name
        raw.append(str(path))
        passed.append(str(write(tmp_path, f"{k}_passed.obs", whole_records(scan, path.read_bytes()))))
    command = [sys.executable, "-c", RTKLIB_EPOCHS, *passed, *raw]
    run = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60)
    answers = run.stdout.splitlines()
    for name, seen, directly in zip(ODD, answers, answers[len(ODD) :], strict=False):
        assert seen.split()[:5] == ["14.0", "15.0", "16.0", "17.0", "18.0"], name
        assert int(seen.split()[5]) == (15 if name[:2] != "2:" else 46 if "codes" in name else 70), name
        assert len(directly.split()) <= 6, name


def test_flags_and_odd_lines_are_said(tmp_path):
    report = describe_rinex(write(tmp_path, "a.obs", ODD["repaired cycle slips"]))
    assert report.counts == {"epochs": 5, "satellite records": 15, "repaired cycle slips (flag 6)": 1}
    assert "Records of repaired cycle slips (flag 6) are no observations and are left out." in report.notes
    assert report.clean
    report = describe_rinex(write(tmp_path, "b.obs", ODD["one blank before the flag"]))
    assert any(note.startswith("5 epoch lines do not keep to the columns") for note in report.notes)


def test_garbled_file_is_no_empty_one(tmp_path):
    report = describe_rinex(write(tmp_path, "a.obs", odd(" 18 45", " 18:45")))
    assert not noted(report, "The file holds a header only.")
    assert noted(report, "Records are damaged or cut: epochs_garbled 5 (first: line 11, '> 2017 05 12 18:45")


BAD = [
    (b"", InputError, "the file is empty"),
    (b"\x1f\x8b\x08\x00rest", UnsupportedError, "gunzip a.obs"),
    (b"\x1f\x9d\x90", UnsupportedError, "uncompress a.obs"),
    (b"PK\x03\x04", UnsupportedError, "unzip a.obs"),
    (b"1.0                 COMPACT RINEX FORMAT", UnsupportedError, "crx2rnx a.obs"),
    (b"$GPGGA,184455.40,3746.4\r\n", InputError, "the first line is '$GPGGA"),
    (bytes(range(256)), InputError, "expected a RINEX header"),
    (obs_3()[:300].encode(), InputError, "the header does not end"),
    (obs_3(version="     5.00").encode(), UnsupportedError, "version 5.00"),
    (
        obs_3().replace("OBSERVATION DATA   ", "METEOROLOGICAL DATA").encode(), UnsupportedError,
        "file type 'METEOROLOGICAL DATA'",
    ),
    (None, InputError, "file not found"),
]  # fmt: skip


@pytest.mark.parametrize(("data", "kind", "fragment"), BAD)
def test_bad_files(tmp_path, data, kind, fragment):
    path = tmp_path / "a.obs" if data is None else write(tmp_path, "a.obs", data)
    with pytest.raises(kind) as caught:
        describe_rinex(path)
    assert fragment in str(caught.value)
    assert str(path) in str(caught.value)


def test_the_report_of_observations_by_hand(tmp_path):
    """Codes of each system, also on a second line; epochs backwards; a position of zeros, or of words."""
    more = line("       C1W L1W", "SYS / # / OBS TYPES")
    text = obs_3(3).replace("E    2 C1C", f"{more}E    2 C1C")
    report = describe_rinex(write(tmp_path, "a.obs", text))
    assert report.details["codes"] == {"GPS": "C1C L1C C2S L2S C1W L1W", "GAL": "C1C L1C"}
    assert (report.details["time_system"], report.format) == ("GPS", "RINEX 3.04 observation")
    assert report.time_scale == "gps"
    assert not report.notes
    glo = describe_rinex(write(tmp_path, "a.obs", obs_3(3, scale="GLO")))
    assert glo.time_scale == "utc"
    back = obs_3(3).replace("45 16.0", "45 13.0")
    assert noted(describe_rinex(write(tmp_path, "a.obs", back)), "The epochs are not in order of time.")
    same = obs_3(3).replace("45 16.0", "45 15.0")
    assert noted(describe_rinex(write(tmp_path, "a.obs", same)), "The epochs are not in order of time.")
    for position in ("        0.0000        0.0000        0.0000", "no position known", "1.0 nan 2.0", "1 2"):
        report = describe_rinex(write(tmp_path, "a.obs", obs_3(3, position=position)))
        assert noted(report, "The header holds no approximate position (it is absent or zero).")
    on_axis = describe_rinex(write(tmp_path, "a.obs", obs_3(3, position="  6378137.0 0.0 0.0")))
    assert on_axis.details["approx_ecef_m"] == [6378137.0, 0.0, 0.0]
    assert not on_axis.notes
    none = obs_3(3).replace("ANTENNA: DELTA H/E/N", "COMMENT")
    assert describe_rinex(write(tmp_path, "a.obs", none)).details["antenna_delta_hen_m"] == [0.0, 0.0, 0.0]
    navigation = describe_rinex(
        write(tmp_path, "a.nav", nav_3("GG").replace("G02 2017 05 12", "G02 2017 05 13"))
    )
    assert navigation.t_last_s - navigation.t_first_s == 86_400.0
    assert navigation.details["systems"] == "GPS"


def test_header_only_is_said(tmp_path):
    report = describe_rinex(write(tmp_path, "a.nav", nav_3("")))
    assert report.counts == {"ephemerides": 0}
    assert not report.synchronised
    assert "The file holds a header only." in report.notes


def test_fuzz_rinex(tmp_path, fuzz):
    for data in fuzz.inputs(obs_3(20).encode(), obs_2(4).encode(), nav_3("GREC").encode(), most=6):
        path = write(tmp_path, "f.rnx", data)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", LeapSecondWarning)  # a flipped year may lie in the future
                scan = scan_rinex(path)
                report = describe_rinex(path)
        except ThalwegError as error:
            assert str(path) in str(error)  # noqa: PT017
        else:
            fuzz.was_read(reported=not report.clean)
            assert np.all(np.isfinite(scan.t_gps_s))
    fuzz.check(read=0.3, troubled=0.3)


@pytest.mark.real
@pytest.mark.parametrize("version", [211, 304, 400])
def test_files_written_by_rtklib(data_dir, tmp_path, version):
    """The same observations written by another program in three versions of the format."""
    log = data_dir / "sbp_piksi_rtk_2017" / "2017-05-12-v1.1.26.sbp"
    code = (
        "import sys, pyrtklib5 as r\n"
        "o = r.rnxopt_t(); o.rnxver = int(sys.argv[2]); o.navsys = 1; o.obstype = 15; o.freqtype = 31\n"
        "r.convrnx(r.STRFMT_SBP, o, sys.argv[1], ['a.obs', 'a.nav', '', '', '', '', '', '', ''])\n"
    )
    command = [sys.executable, "-c", code, str(log), str(version)]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=60)
    scan = scan_rinex(tmp_path / "a.obs")
    reference = scan_rinex(log.parent / "reference" / "piksi_rover.obs")
    assert scan.version == f"{version / 100:.2f}"
    assert not scan.losses
    assert np.array_equal(scan.t_gps_s, reference.t_gps_s)
    assert scan.n_satellite_records == reference.n_satellite_records
    nav = scan_rinex(tmp_path / "a.nav")
    assert not nav.losses
    assert nav.nav_t_gps_s["GPS"].size == 10  # as sbp2rinex wrote: reference/piksi_rover.nav


@pytest.mark.real
def test_real_navigation(data_dir):
    path = data_dir / "rinex_cssrlib_kinematic_2021" / "SEPT2650.21P"
    heads = [ln for ln in path.read_text().splitlines() if ln[:1] in "GREJCIS" and ln[3:8] == " 2021"]
    report = describe_rinex(path)
    assert report.counts == {"ephemerides": len(heads)}
    assert report.clean


def test_a_number_with_a_blank_inside_is_garbled(tmp_path):
    """Such a count of satellites ended in a ValueError."""
    odd = obs_3(3).replace("  0  3", "  00 3", 1)
    assert scan_rinex(write(tmp_path, "a.obs", odd)).losses == {"epochs_garbled": 1}


REAL = [
    ("rinex_cssrlib_kinematic_2021/SEPT265G.21O", "epochs", 360, "2021-09-22T06:29:42.000Z"),
    ("rinex_cssrlib_kinematic_2021/3034265G.21O", "epochs", 360, "2021-09-22T06:29:42.000Z"),
    ("sbp_piksi_rtk_2017/reference/piksi_rover.obs", "epochs", 400, "2017-05-12T18:44:56.000Z"),
    ("sbp_piksi_rtk_2017/reference/piksi_base.obs", "epochs", 439, "2017-05-12T18:44:16.000Z"),
]


@pytest.mark.real
@pytest.mark.parametrize(("name", "what", "n", "first"), REAL)
def test_real_files(data_dir, name, what, n, first):
    report = describe_rinex(data_dir / name)  # figures of the PROVENANCE.md files, UTC = GPST - 18 s
    assert report.counts[what] == n
    assert report.clean
    assert utc_text_from_gps(report.t_first_s) == first
