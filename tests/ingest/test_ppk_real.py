"""PPK on recordings of other people: figures of their PROVENANCE.md, second routes, damage, determinism."""

import shutil
import struct
import subprocess

import numpy as np
import pandas as pd
import pytest

from tests.bands import band
from thalweg.core import ArrayF, ConfigError, InputError, LocalFrame, ThalwegError, write_table
from thalweg.core.timescales import week_from_gps
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.ppk import PpkOptions, run_ppk
from thalweg.ingest.ppk.trust import SIGMA_FLOOR_M, covariance_enu

pytestmark = pytest.mark.real

SBP_BASE = (-2706105.2018, -4261210.8062, 3885598.6411)
SBP_ENU_M = (-5.3331, -5.0651, -0.0630)  # PROVENANCE.md: pyrtklib5 0.2.8 on the same log
GEONET_3034 = (-3959400.631, 3385704.533, 3667523.111)
FRAME = LocalFrame(lat_deg=37.773497750, lon_deg=-122.417811914, h_ell_m=-6.2480)  # at SBP_BASE
START = LocalFrame(lat_deg=35.342058098, lon_deg=139.521986657, h_ell_m=47.5515)  # published start


def sbp_options(**kwargs: object) -> PpkOptions:
    base = {} if {"base_ecef_m", "base_source"} & set(kwargs) else {"base_source": "from_sbp"}
    return PpkOptions(elevation_mask_deg=10.0, **base, **kwargs)


def enu(positions: pd.DataFrame, frame: LocalFrame = FRAME) -> ArrayF:
    return frame.from_geodetic(positions["lat_deg"], positions["lon_deg"], positions["h_ell_m"])


@pytest.fixture(scope="module")
def sbp(data_dir):
    return data_dir / "sbp_piksi_rtk_2017" / "2017-05-12-v1.1.26.sbp"


@pytest.fixture(scope="module")
def reference(data_dir):
    return data_dir / "sbp_piksi_rtk_2017" / "reference"


@pytest.fixture(scope="module")
def static(sbp):
    return run_ppk([sbp], None, [], sbp_options())


@pytest.fixture(scope="module")
def car(data_dir):
    k = data_dir / "rinex_cssrlib_kinematic_2021"
    options = PpkOptions(base_ecef_m=GEONET_3034)  # the systems of both logs
    return run_ppk([k / "SEPT265G.21O"], [k / "3034265G.21O"], [k / "SEPT2650.21P"], options)


def test_sbp_alone(static, record_property):
    d = static.report.details
    assert len(static.positions) == d["n_rover_epochs"] == 400
    assert d["n_fixed"] == pytest.approx(
        378, abs=3
    )  # PROVENANCE.md; 3 epochs for another build of the engine
    record_property("n_fixed", d["n_fixed"])
    assert d["n_float"] == 400 - d["n_fixed"]
    assert d["fix_ratio"] == d["n_fixed"] / 400
    assert static.report.counts["base epochs"] == 439
    assert static.report.counts["ephemerides"] == 10
    assert np.mean(enu(static.fixed), axis=0) == pytest.approx(SBP_ENU_M, abs=1e-3)
    assert d["baseline_m"] == pytest.approx(np.linalg.norm(SBP_ENU_M), abs=2e-3)
    assert d["base_check_m"] < 10.0  # single-point positions are good to metres
    assert static.base_ecef_m == pytest.approx(SBP_BASE, abs=1e-4)
    t = static.positions["t_gps_s"].to_numpy()
    assert week_from_gps(t[[0, -1]])[1] == pytest.approx([499514.0, 499913.0], abs=1e-6)
    # The log was cut at 2,000,000 bytes: the last 102 bytes are the head of a frame.
    assert static.report.losses == {"rover SBP bytes outside of intact frames": 102}
    assert static.report.details["engine"] == "pyrtklib5 0.2.8 (RTKLIB EX 2.5.0)"


def test_consistent_with_the_receiver_epoch_by_epoch(static, sbp, record_property):
    """MsgBaselineNED (0x020C) in fixed mode, read here with struct: another engine on the same signals."""
    data = sbp.read_bytes()
    onboard: dict[int, tuple[float, float, float]] = {}
    at = -1
    while (at := data.find(b"\x55\x0c\x02", at + 1)) >= 0:
        if at + 30 <= len(data) and data[at + 5] == 22:
            tow_ms, n, e, d, _, _, _, flags = struct.unpack_from("<IiiiHHBB", data, at + 6)
            if flags & 7 == 4:
                onboard[tow_ms] = (e / 1e3, n / 1e3, -d / 1e3)
    tow_ms = np.round(week_from_gps(static.fixed["t_gps_s"])[1] * 1e3).astype(int)
    common = [(k, tow) for k, tow in enumerate(tow_ms) if tow in onboard]
    assert len(common) > 350
    difference = enu(static.fixed)[[k for k, _ in common]] - [onboard[tow] for _, tow in common]
    mean = difference.mean(axis=0)
    record_property("horizontal_mm", 1e3 * np.hypot(mean[0], mean[1]))
    record_property("up_mm", 1e3 * mean[2])
    assert np.hypot(mean[0], mean[1]) < 5e-3  # asked for; measured 1.2 mm
    assert abs(mean[2]) < 25e-3  # asked for; measured -23.0 mm: two engines, two weightings by elevation
    assert np.max(np.abs(difference)) < 40e-3  # measured 33 mm, in height


def test_rinex_route_equals_the_sbp_route(static, reference):
    """Swift's sbp2rinex wrote these files, the engine's own converter those of the other route."""
    files = [reference / f"piksi_{name}" for name in ("rover.obs", "base.obs", "rover.nav")]
    route = run_ppk([files[0]], [files[1]], [files[2]], sbp_options(base_source="rinex_header"))
    assert list(route.positions["fix"]) == list(static.positions["fix"])
    # The header's base has four decimals, so has the height: 0.1 mm, one unit of the last place.
    assert np.max(np.abs(enu(route.positions) - enu(static.positions))) < 2e-4
    assert any("approximate position of a RINEX header" in note for note in route.report.notes)


def test_a_shifted_base_shifts_the_answer(static, sbp):
    place, antenna = np.array([1.0, 0.0, -0.5]), np.array([0.0, 0.4, 0.3])
    shift = place + antenna
    moved = tuple(static.base_ecef_m + FRAME.R_ecef_enu @ place)
    options = sbp_options(base_ecef_m=moved, base_antenna_delta_enu_m=tuple(antenna))
    answer = run_ppk([sbp], None, [], options)
    both = (static.positions["fix"] == "fixed") & (answer.positions["fix"] == "fixed")
    difference = (enu(answer.positions) - enu(static.positions))[both]
    # 1 m over 20,000 km to a satellite tilts the line of sight by 5e-8: 0.4 um on 7 m; the text has 0.1 mm.
    assert difference.mean(axis=0) == pytest.approx(shift, abs=5e-4)


def sigmas_m(positions: pd.DataFrame) -> ArrayF:
    return np.sqrt(np.diagonal(covariance_enu(positions), axis1=1, axis2=2))


def test_static_scatter_against_predicted_sigma(static):
    """The stated sigma is of the size of the scatter of 6.3 minutes.

    Measured: 1.2, 1.8, 2.2 mm against 2.4, 2.7, 5.3 mm: ratios 0.52, 0.67, 0.42 (of the engine's own 0.26,
    0.33, 0.21). The scatter of a short session misses slow multipath, so that less than one is expected.
    """
    ratio = enu(static.fixed).std(axis=0) / np.sqrt(np.mean(sigmas_m(static.fixed) ** 2, axis=0))
    assert np.all(ratio < 1.0)
    assert np.all(ratio > 0.35)
    assert static.report.details["fixed_sigma_factor"] == pytest.approx(0.49, abs=0.02)


def test_float_sigmas_hold_from_the_first_second(static, car):
    """Errors of the first 22 and 12 seconds over sigmas: 0.7 (were 0.2) and 0.8 (0.1)."""
    mean = static.fixed[["lat_deg", "lon_deg", "h_ell_m"]].mean()
    for solution, frame in ((static, LocalFrame(**mean)), (car, START)):
        floats = solution.positions[solution.positions["fix"] == "float"]
        floats = floats[floats["t_gps_s"] < solution.positions["t_gps_s"].iloc[0] + 30.0]
        rms = np.sqrt(np.mean(enu(floats, frame) ** 2) / np.mean(sigmas_m(floats) ** 2))
        low, high = np.sqrt(band(3, level=0.99))  # a filter that converges is one observation of each axis
        assert max(low, 0.4) < rms < high


def test_a_car_at_rest_lies_within_its_sigmas_of_the_published_place(car):
    """19 fixed epochs at 5.4 km, one observation of each axis: NEES 1.2 (was 4.2)."""
    rest = car.fixed[car.fixed["t_gps_s"] < car.positions["t_gps_s"].iloc[0] + 30.0]
    d = enu(rest, START)
    nees = np.einsum("ni,nij,nj->n", d, np.linalg.inv(covariance_enu(rest)), d).mean() / 3
    low, high = band(3, level=0.95)
    assert low < nees < high


def test_covariances_are_positive_definite(static, car, tmp_path):
    """The engine wrote 38 indefinite ones in 360 epochs of the car (dynamics off) and none on the roof."""
    for solution in (static, car):
        C = covariance_enu(solution.positions)
        assert np.linalg.eigvalsh(C)[:, 0].min() >= 0.999 * SIGMA_FLOOR_M**2
        write_table(tmp_path / "a.parquet", solution.positions, GNSS_POSITION)
    assert static.report.details["n_covariances_replaced"] == 0
    assert 20 < car.report.details["n_covariances_replaced"] < 80
    assert any("replaced by the median of their neighbours" in note for note in car.report.notes)


def test_dynamics_keep_the_digits_of_the_covariance(data_dir, car):
    k = data_dir / "rinex_cssrlib_kinematic_2021"
    options = PpkOptions(base_ecef_m=GEONET_3034, systems=("GPS", "GAL", "QZS"), dynamics=True)
    smooth = run_ppk([k / "SEPT265G.21O"], [k / "3034265G.21O"], [k / "SEPT2650.21P"], options)
    assert smooth.report.details["n_covariances_replaced"] == 0
    both = ((smooth.positions["fix"] == "fixed") & (car.positions["fix"] == "fixed")).to_numpy()
    difference = np.linalg.norm((enu(smooth.positions, START) - enu(car.positions, START))[both], axis=1)
    assert np.median(difference) < 0.01  # measured 4.9 mm (95 %: 17 mm): the two filters smooth differently


def test_car(car, record_property):
    d = car.report.details
    assert len(car.positions) == d["n_rover_epochs"] == 360
    assert d["n_fixed"] == pytest.approx(348, abs=3)  # PROVENANCE.md
    assert d["n_float"] == 360 - d["n_fixed"]
    off_m = np.linalg.norm(enu(car.fixed, START)[0])
    record_property("n_fixed", d["n_fixed"])
    record_property("off_mm", 1e3 * off_m)
    assert off_m < 0.03  # published point; PROVENANCE.md: 24 mm
    path_m = np.sum(np.linalg.norm(np.diff(enu(car.fixed, START), axis=0), axis=1))
    assert path_m == pytest.approx(1482.9, abs=2.0)  # PROVENANCE.md; which epochs are fixed changes metres
    assert d["baseline_m"] == pytest.approx(5360.0, abs=60.0)
    assert not any("phase bands" in note for note in car.report.notes)


def test_instantaneous_never_passes_as_fixed(sbp):
    """The trap of this engine: no ambiguity is fixed, and the result must say so."""
    answer = run_ppk([sbp], None, [], sbp_options(ambiguity="instantaneous"))
    assert set(answer.positions["fix"]) == {"float"}
    assert answer.report.details["n_fixed"] == 0
    assert any("'instantaneous' fixes next to nothing" in note for note in answer.report.notes)
    assert any("No position is fixed" in note for note in answer.report.notes)


@pytest.mark.parametrize(
    "options",
    [{"direction": "combined"}, {"direction": "backward", "ambiguity": "fix-and-hold"}, {"dynamics": True}],
)
def test_other_modes_agree(sbp, options):
    answer = run_ppk([sbp], None, [], sbp_options(**options))
    assert answer.fix_ratio > 0.9
    assert np.mean(enu(answer.fixed), axis=0) == pytest.approx(
        SBP_ENU_M, abs=2e-3
    )  # other epochs in the mean
    assert any("independent" in n for n in answer.report.notes) == (options.get("direction") == "combined")


def test_rover_in_two_files(static, reference, tmp_path):
    """Listed apart, the engine would take the second rover file for the base."""
    lines = (reference / "piksi_rover.obs").read_text().splitlines(keepends=True)
    body = next(i for i, ln in enumerate(lines) if "END OF HEADER" in ln) + 1
    half = [i for i, ln in enumerate(lines) if ln.startswith(">")][200]
    (tmp_path / "z.obs").write_text("".join(lines[:half]))
    (tmp_path / "a.obs").write_text("".join(lines[:body] + lines[half:]))
    rover = [tmp_path / "z.obs", tmp_path / "a.obs"]
    options = sbp_options(base_ecef_m=tuple(static.base_ecef_m))
    answer = run_ppk(rover, [reference / "piksi_base.obs"], [reference / "piksi_rover.nav"], options)
    assert answer.report.counts["rover epochs"] == 400
    assert np.max(np.abs(enu(answer.positions) - enu(static.positions))) < 2e-4


def test_sbp_in_two_files(static, sbp, tmp_path):
    data = sbp.read_bytes()
    parts = [tmp_path / "0.sbp", tmp_path / "1.sbp"]
    for part, piece in zip(parts, (data[:1_000_003], data[1_000_003:]), strict=True):
        part.write_bytes(piece)  # the cut goes through a frame
    answer = run_ppk(parts, None, [], sbp_options())
    pd.testing.assert_frame_equal(answer.positions, static.positions, check_exact=True)


def test_damaged_rinex_loses_the_damaged_epochs_only(static, reference, tmp_path):
    """Left to itself, the engine loses the epoch behind a damaged one too (398 of 400 for one bad line)."""
    lines = (reference / "piksi_rover.obs").read_text().splitlines(keepends=True)
    heads = [i for i, ln in enumerate(lines) if ln.startswith(">")]
    lines[heads[200]] = lines[heads[200]].replace("2017", "20x7")
    lines[heads[300] + 2] = lines[heads[300] + 2].replace("G", "\x00", 1)
    path = tmp_path / "rover.obs"
    path.write_text("".join(lines)[:-40])
    options = sbp_options(base_ecef_m=tuple(static.base_ecef_m))
    answer = run_ppk([path], [reference / "piksi_base.obs"], [reference / "piksi_rover.nav"], options)
    assert answer.report.losses == {"rover epochs_garbled": 2, "rover epochs_cut": 1}
    assert len(answer.positions) == 397


def test_epochs_without_base_are_counted(static, reference, tmp_path):
    """A base that ends after 100 rover epochs leaves single positions, marked as such."""
    text = (reference / "piksi_base.obs").read_text()
    path = tmp_path / "base.obs"
    path.write_text(text[: text.index("> 2017 05 12 18 46 54")])
    options = sbp_options(base_ecef_m=tuple(static.base_ecef_m))
    answer = run_ppk([reference / "piksi_rover.obs"], [path], [reference / "piksi_rover.nav"], options)
    d = answer.report.details
    assert d["n_single"] + d["n_none"] == pytest.approx(270, abs=2)  # 300 less 30 s of allowed age
    assert any("have no base observation within 30 s" in note for note in answer.report.notes)
    last = answer.positions.iloc[-1]
    assert last["fix"] == "single"
    assert d["fix_ratio"] < 0.35
    assert sum(d[f"n_{name}"] for name in ("fixed", "float", "single", "other", "none")) == 400


def test_same_log_as_base(sbp):
    with pytest.raises(InputError, match="Give base=None for the corrections inside an SBP log"):
        run_ppk([sbp], [sbp], [], sbp_options())


def test_fuzz_engine_on_damaged_logs(sbp, tmp_path, fuzz, fuzz_count):
    """Whatever a damaged log does to the C code, the caller sees a table with counts or a ThalwegError."""
    head, path = sbp.read_bytes()[:600_000], tmp_path / "fuzz.sbp"

    def damage(data, rng):
        parts = [data[i : i + 3000] for i in range(0, len(data), 3000)]  # damage all over, cuts within a part
        return b"".join(fuzz.damaged(part, most=2, longest=400) for part in parts)

    for data in fuzz.inputs(head, by=damage, count=max(3, fuzz_count // 60), limit_s=90.0):
        path.write_bytes(data)
        try:
            answer = run_ppk([path], None, [], sbp_options(base_ecef_m=SBP_BASE), time_limit_s=60.0)
        except ThalwegError as error:
            assert not isinstance(error, ConfigError)  # noqa: PT017
        else:
            fuzz.was_read(reported=answer.report.losses["rover SBP bytes outside of intact frames"] > 0)
            assert set(answer.positions["fix"]) <= {"fixed", "float", "dgnss", "single"}
    fuzz.check(read=0.1, troubled=0.9)


@pytest.mark.skipif(
    shutil.which("rnx2rtkp") is None, reason="rnx2rtkp (Debian package rtklib) is not on PATH"
)
def test_against_stock_rtklib(static, reference, tmp_path):
    """Another build of RTKLIB (2.4.3 b34), settings in its own words; some fix flags differ."""
    config = tmp_path / "stock.conf"
    config.write_text(
        "pos1-posmode=kinematic\npos1-frequency=l1+l2\npos1-soltype=forward\npos1-elmask=10\n"
        "pos1-ionoopt=brdc\npos1-tropopt=saas\npos1-navsys=1\npos2-armode=continuous\npos2-gloarmode=off\n"
        "pos2-arthres=3\nout-solformat=enu\nout-timeform=tow\nant2-postype=xyz\n"
        + "".join(f"ant2-pos{k + 1}={x}\n" for k, x in enumerate(SBP_BASE))
    )
    out = tmp_path / "stock.pos"
    files = [str(reference / f"piksi_{name}") for name in ("rover.obs", "base.obs", "rover.nav")]
    subprocess.run(["rnx2rtkp", "-k", str(config), "-o", str(out), *files], check=True, capture_output=True)
    rows = np.array(
        [ln.split() for ln in out.read_text().splitlines() if not ln.startswith("%")], dtype=float
    )
    fixed = rows[rows[:, 5] == 1]
    assert len(fixed) == pytest.approx(381, abs=3)  # PROVENANCE.md
    ours = dict(zip(np.round(week_from_gps(static.fixed["t_gps_s"])[1]), enu(static.fixed), strict=True))
    difference = np.array([row[2:5] - ours[row[1]] for row in fixed if row[1] in ours])
    # Measured 367: at the start 14 epochs are fixed by the stock engine only, later 11 by ours only.
    assert len(difference) > 360
    assert np.max(np.abs(difference)) < 1e-3  # measured 0.6 mm, in height
