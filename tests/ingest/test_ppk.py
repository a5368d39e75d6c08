"""PPK inputs, the process border of the engine, and its .pos text: bad input and crashes, no recordings."""

import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from tests.ingest.test_rinex import line
from tests.ingest.writers import sbp
from thalweg.core import ConfigError, InputError
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.ppk import PpkOptions, replace_covariances, run_ppk, solution
from thalweg.ingest.ppk.solution import PpkSolution, check_settings, run_worker, write_settings
from thalweg.ingest.ppk.trust import SIGMA_FLOOR_M, covariance_enu, read_solution

BASE = (-2706105.2018, -4261210.8062, 3885598.6411)
OPTIONS = PpkOptions(base_ecef_m=BASE, systems=("GPS", "GAL"))


def observations(
    minute: int = 45, systems: str = "GE", position: tuple[float, ...] = BASE, n: int = 5
) -> bytes:
    text = line(f"{'     3.04':20s}{'OBSERVATION DATA':20s}M", "RINEX VERSION / TYPE")
    text += line("".join(f"{x:14.4f}" for x in position), "APPROX POSITION XYZ")
    text += "".join(line(f"{s}    4 C1C L1C C2S L2S", "SYS / # / OBS TYPES") for s in systems)
    text += line("  2017    05    12    18    45   14.0000000     GPS", "TIME OF FIRST OBS")
    text += line("", "END OF HEADER")
    for k in range(n):
        text += f"> 2017 05 12 18 {minute:02d} {14 + k:2d}.0000000  0{4 * len(systems):3d}\n"
        for s in systems:
            text += "".join(
                f"{s}{p:02d}{23870514.32 + k:14.3f}  {125440402.25:14.3f}  \n" for p in range(1, 5)
            )
    return text.encode()


def ephemerides(day: int = 12, systems: str = "GE") -> bytes:
    text = line(f"{'     3.04':20s}{'N: GNSS NAV DATA':20s}M", "RINEX VERSION / TYPE") + line(
        "", "END OF HEADER"
    )
    for s in systems:
        text += f"{s}01 2017 05 {day:02d} 20 00 00 -.4D-04  .1D-11  .0D+00\n" + "      .48D+02\n" * 7
    return text.encode()


HEARTBEATS = sbp(0xFFFF, bytes(4)) * 5
ROVER_ONLY = HEARTBEATS + sbp(0x004A, struct.pack("<IiHB", 499514000, 0, 1948, 0x10)) * 3

GOOD = {"rover": observations(), "base": observations(n=9), "nav": ephemerides()}
BAD_INPUT: list[tuple[str, dict[str, bytes | None], dict[str, object], str]] = [
    ("no overlap", {"base": observations(minute=10)}, {}, "do not overlap in time"),
    ("nav empty file", {"nav": b""}, {}, "the file is empty"),
    ("nav header only", {"nav": ephemerides(systems="")}, {}, "the navigation files hold no ephemeris"),
    ("nav not given", {"nav": None}, {}, "no navigation file is given"),
    ("nav of another day", {"nav": ephemerides(day=14)}, {}, "no ephemeris of GAL, GPS is valid"),
    ("nav of another system", {"nav": ephemerides(systems="R")}, {}, "hold GLO 2017-05-12T20:00:00Z"),
    ("obs as nav", {"nav": observations(minute=46)}, {}, "RINEX observation data given as navigation"),
    ("nav as rover", {"rover": ephemerides(day=11)}, {}, "RINEX navigation data given as rover"),
    ("nav as base", {"base": ephemerides(day=11)}, {}, "RINEX navigation data given as base"),
    ("rover is base", {"base": observations()}, {}, "the same content is given as rover"),
    ("rover without base", {"base": None}, {}, "only an SBP rover holds observations"),
    ("text file", {"rover": b"hello world\n" * 99}, {}, "neither an SBP or UBX log nor a RINEX file"),
    ("gzip", {"base": b"\x1f\x8b\x08rest"}, {}, "Unpack it: gunzip"),
    ("Hatanaka", {"base": b"3.0                 COMPACT RINEX FORMAT\n"}, {}, "crx2rnx"),
    ("cut in the header", {"rover": observations()[:200]}, {}, "the header does not end"),
    (
        "cut before the first epoch",
        {"rover": observations(n=1)[:-30]},
        {},
        "no epoch with observations of the rover; rover: damaged or cut records were left out of rover.rnx: "
        "epochs_cut 1 (first: line ",
    ),
    (
        "time of BeiDou",  # RTKLIB reads epochs of BDT as if they were GPS time, 14 s off
        {"base": observations(n=9).replace(b"   GPS   ", b"   BDT   ")},
        {},
        "epochs of the base in the time system BDT; expected one of GPS, GAL,",
    ),
    ("no common system", {"base": observations(systems="R")}, {}, "none of the systems GPS, GAL is in rover"),
    (
        "zero base header",
        {"base": observations(n=9, position=(0.0, 0.0, 0.0))},
        {"base_ecef_m": None, "base_source": "rinex_header"},
        "the APPROX POSITION XYZ of the base is all zero",
    ),
    (
        "base from SBP without SBP",
        {},
        {"base_ecef_m": None, "base_source": "from_sbp"},
        "no valid position of the base",
    ),
    ("SBP without observations", {"rover": HEARTBEATS, "base": None}, {}, "no rover observations (MsgObs)"),
    (
        "SBP without corrections",
        {"rover": ROVER_ONLY, "base": None},
        {},
        "no base observations (MsgObs of sender 0)",
    ),
    (
        "SBP cut to nothing",
        {"rover": ROVER_ONLY[:7], "base": None},
        {},
        "neither an SBP or UBX log nor a RINEX file",
    ),
]


def run(folder: Path, files: dict[str, bytes | None], options: dict[str, object]) -> PpkSolution:
    paths = {}
    for role, data in {**GOOD, **files}.items():
        if data is not None:
            paths[role] = folder / f"{role}.rnx"
            paths[role].write_bytes(data)
    base = [paths["base"]] if "base" in paths else None
    nav = [paths["nav"]] if "nav" in paths else []
    chosen = PpkOptions(**{"base_ecef_m": BASE, "systems": ("GPS", "GAL"), **options})
    return run_ppk([paths["rover"]], base, nav, chosen)


@pytest.mark.parametrize(
    ("files", "options", "fragment"), [b[1:] for b in BAD_INPUT], ids=[b[0] for b in BAD_INPUT]
)
def test_bad_input(tmp_path, files, options, fragment):
    with pytest.raises(InputError) as caught:
        run(tmp_path, files, options)
    assert fragment in str(caught.value)
    assert caught.value.where.startswith(str(tmp_path))
    assert caught.value.expected


def test_what_damaged_files_lose_adds_up(tmp_path):
    whole = observations(n=3)
    (tmp_path / "a.obs").write_bytes(whole[:-20])
    (tmp_path / "b.obs").write_bytes(observations(n=2)[:-20])
    found = solution.PpkInputs()
    solution._copy_rinex([tmp_path / "a.obs", tmp_path / "b.obs"], tmp_path, "rover", "obs", found)
    assert dict(found.losses) == {"rover epochs_cut": 2}
    assert found.bytes_read == len(whole) + len(observations(n=2)) - 40
    assert [note.split(":")[1] for note in found.notes] == [
        f" damaged or cut records were left out of {name}.obs" for name in "ab"
    ]
    assert len((tmp_path / "rover_000.obs").read_bytes()) < len(whole) - 20


@pytest.mark.parametrize(("fix", "again"), [(("fixed", "float"), True), (("float", "float"), False)])
def test_fixes_are_judged_by_a_solution_without_them(monkeypatch, fix, again):
    """Also where some epochs are fixed alone; one that has none is its own."""
    asked: list[tuple[str, bool]] = []
    judged: list[pd.DataFrame] = []

    def solve(_folder, _inputs, options, *, single, **_):
        asked.append((options.ambiguity, single))
        table = pd.DataFrame(
            {"fix": fix if options.ambiguity != "off" else ("float", "float"), "h_ell_m": 1.0}
        )
        return SimpleNamespace(positions=table, residuals=None, answer=None)

    def trusted(positions, floats, *_, **__):
        judged.extend((positions, floats))
        raise ZeroDivisionError

    for name, value in {
        "prepare_inputs": lambda *_, **__: None,
        "preflight": lambda *_: [],
        "_base_position": lambda *_: (np.array(BASE), []),
        "_check_base": lambda *_: (0.0, []),
        "_solve": solve,
        "_places": lambda table: np.zeros((len(table), 3)),
        "replace_covariances": lambda table: (table, 0),
        "phase_factor": lambda _: 1.0,
        "code_factors": lambda _: None,
        "trust_fixes": trusted,
    }.items():
        monkeypatch.setattr(solution, name, value)
    with pytest.raises(ZeroDivisionError):
        run_ppk([Path("a.obs")], [Path("b.obs")], [], OPTIONS)
    usual = OPTIONS.ambiguity
    assert asked == [(usual, True), (usual, False), *([("off", False)] if again else [])]
    assert [table["fix"].tolist() for table in judged] == [list(fix), ["float", "float"]]


def test_no_files_and_missing_file(tmp_path):
    with pytest.raises(InputError, match="no rover files"):
        run_ppk([], None, [], OPTIONS)
    with pytest.raises(InputError, match="file not found"):
        run_ppk([tmp_path / "none.sbp"], None, [], OPTIONS)


def test_unusable_observations_give_an_error_with_what_the_engine_printed(tmp_path):
    """Ephemerides of zeros pass the checks before the run; no position comes out, and that is said."""
    with pytest.raises(InputError, match=r"no position for 5 rover epochs; it printed: .+"):
        run(tmp_path, {}, {})


CRASHES = [
    ("import os; os.abort()", "crashed with SIGABRT"),
    (
        "import ctypes; print('before', flush=True); ctypes.string_at(0)",
        "crashed with SIGSEGV; it printed: before",
    ),
    (
        "import sys; print('reading ephemeris'); sys.exit(3)",
        "ended with exit code 3; it printed: reading ephemeris",
    ),
    ("raise ValueError('inside')", "ValueError: inside"),
    ("pass", "ended with exit code 0"),
    (
        "import time; print('stuck', flush=True); time.sleep(60)",
        "did not finish within 1 s; it printed: stuck",
    ),
]


@pytest.mark.parametrize(("code", "fragment"), CRASHES)
def test_crash_of_the_engine_is_an_input_error(tmp_path, code, fragment):
    worker = tmp_path / "worker.py"
    worker.write_text(code)
    with pytest.raises(InputError) as caught:
        run_worker(
            [], tmp_path, where="rover.sbp", time_limit_s=1.0 if "sleep" in code else 60.0, worker=worker
        )
    assert fragment in str(caught.value)
    assert str(caught.value).startswith("rover.sbp: the RTKLIB engine")


def test_progress_lines_are_told_once(tmp_path):
    worker = tmp_path / "worker.py"
    worker.write_text(
        "import json, sys\n"
        "[print(f'processing : 2017/05/12 18:45:{k:02d}.0 Q=1', end='\\r') for k in range(60)]\n"
        "print('\\nno nav data')\n"
        "open(sys.argv[2], 'w').write(json.dumps({'engine': 'x', 'answers': []}))\n"
    )
    answer = run_worker([], tmp_path, where="", time_limit_s=60.0, worker=worker)
    assert answer.output == "processing : 2017/05/12 18:45:59.0 Q=1 | no nav data"


def test_a_setting_that_the_engine_ignores_is_found(tmp_path):
    """The engine keeps its default for a word that it does not know, and says nothing."""
    settings = {"pos2-armode": "nonsense", "pos1-elmask": "10"}
    write_settings(tmp_path / "a.conf", settings)
    task = {
        "action": "solve",
        "config": str(tmp_path / "a.conf"),
        "readback": str(tmp_path / "a.taken"),
        "inputs": [],
        "output": str(tmp_path / "a.pos"),
        "interval_s": 0.0,
    }
    answer = run_worker([task], tmp_path, where="", time_limit_s=60.0)
    assert answer.engine.startswith("RTKLIB EX")
    with pytest.raises(ConfigError) as caught:
        check_settings(tmp_path / "a.taken", settings)
    assert "pos2-armode: asked 'nonsense', taken 'fix-and-hold'" in str(caught.value)
    assert "elmask" not in str(caught.value)


HEAD = (
    "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"
    "  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio\n"
)
LINE = (
    "1948 499911.000000   37.773452096 -122.417872458    -6.3120   1   9   0.0054   0.0048   0.0107  -0.0001"
    "   0.0019  -0.0048   0.00   19.3\n"
)


def test_solution_of_the_engine(tmp_path):
    path = tmp_path / "a.pos"
    path.write_text(HEAD + LINE)
    row = read_solution(path).iloc[0]
    assert row["t_gps_s"] == 1948 * 604800 + 499911.0 - 1e9
    assert [row[f"sigma_{n}_m"] for n in ("north", "east", "up")] == pytest.approx([0.0054, 0.0048, 0.0107])
    assert row["cov_en_m2"] == pytest.approx(-1e-8)  # a signed square root is written
    assert row["cov_eu_m2"] == pytest.approx(0.0019**2)
    assert row["cov_nu_m2"] == pytest.approx(-(0.0048**2))
    assert row["fix"] == "fixed"


def test_no_solution_is_an_empty_table(tmp_path):
    path = tmp_path / "a.pos"
    assert list(read_solution(path).columns) == list(GNSS_POSITION.names)
    path.write_text(HEAD)
    assert read_solution(path).empty
    assert replace_covariances(read_solution(path))[1] == 0


@pytest.mark.parametrize("bad", ["1948 499911.0 37.7", LINE.strip() + " 7", "1948 " + "x " * 14])
def test_damaged_solution_is_refused(tmp_path, bad):
    path = tmp_path / "a.pos"
    path.write_text(HEAD + LINE + bad + "\n")
    with pytest.raises(InputError, match="1 lines of the engine's solution are damaged"):
        read_solution(path)


def noisy(n: int = 61) -> pd.DataFrame:
    table = pd.DataFrame({name: np.zeros(n) for name in GNSS_POSITION.names})
    table["fix"] = "fixed"
    table[["sigma_east_m", "sigma_north_m", "sigma_up_m"]] = (0.003, 0.004, 0.01)
    table["cov_nu_m2"] = -1.2e-5
    return table


def test_indefinite_covariance_is_replaced_by_its_neighbours():
    table = noisy()
    table.loc[30, "sigma_east_m"] = 0.0
    table.loc[30, "cov_en_m2"] = 9e-6
    table.loc[31, "fix"] = "float"
    table.loc[31, "sigma_east_m"] = 0.5
    fixed, n = replace_covariances(table)
    assert n == 1
    expected = noisy()
    expected.loc[31, ["fix", "sigma_east_m"]] = ["float", 0.5]
    pd.testing.assert_frame_equal(fixed, expected, rtol=1e-9, check_exact=False)
    assert table.loc[30, "sigma_east_m"] == 0.0  # the argument stays as it was


def test_covariance_without_good_neighbours_is_raised_to_the_floor():
    table = noisy(1)
    table["sigma_up_m"] = 1e-4
    fixed, n = replace_covariances(table)
    assert n == 1
    assert np.linalg.eigvalsh(covariance_enu(fixed)[0])[0] == pytest.approx(SIGMA_FLOOR_M**2, rel=1e-6)


def test_good_and_unknown_covariances_stay():
    table = noisy()
    table.loc[3, "cov_en_m2"] = np.nan
    fixed, n = replace_covariances(table)
    assert n == 0
    pd.testing.assert_frame_equal(fixed, table)
