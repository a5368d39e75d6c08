"""Tables that loggers write: Deeper's export, a track, depths, and which table is which."""

from functools import partial

import pytest

from tests.ingest.writers import read_or_refused
from thalweg.core import InputError, gps_from_unix
from thalweg.ingest import TrackOptions
from thalweg.ingest.recorders import read_deeper, read_track_table
from thalweg.ingest.registry import (
    also_streams,
    describe,
    read_depths,
    read_positions,
    recognise,
    soundings_table,
    stream_of,
)

UNIX_MS = 1_722_032_248_825
POSITIONS = {"states": None, "base": [], "nav": [], "ppk": {}, "base_position": {}}
TRACK = """Timestamp;Longitude;Latitude;EllipsoidalHeight;Status
2022-05-30 20:13:58.5;-68.5;48.25;20.9;2
2022-05-30 20:13:59.5;-68.5;;20.9;2
2022-05-30 20:14:00.5;-68.25;48.25;21.0;2
"""


def deeper(rows: int) -> str:
    return "".join(f"{35.0 + k * 1e-4},139.5,{k % 7}.5,29.0,{UNIX_MS + 2000 * k}\n" for k in range(rows))


def test_a_deeper_export_gives_depths_and_a_track(tmp_path):
    path = tmp_path / "depths.csv"
    path.write_text(
        deeper(20) + "35.1,139.5,0,29.0,1722032348825\n35.1,139.5,12000,29.0,1722032350825\nbroken\n",
        encoding="utf-8",
    )
    assert (recognise(path), stream_of("deeper", path), also_streams("deeper", path)) == (
        "deeper",
        "depth",
        ["pos"],
    )
    log = read_deeper([path], TrackOptions())
    assert (log.report.counts["pings"], log.report.losses["bad_lines"]) == (22, 1)
    assert log.report.counts["pings_without_bottom"] == 2, "no sea is so deep"
    assert log.soundings["depth_m"].tolist() == [k % 7 + 0.5 for k in range(20)]
    table, _ = read_positions("pos", [path], **POSITIONS)
    assert table["t_gps_s"].iloc[3] == pytest.approx(float(gps_from_unix(UNIX_MS / 1000 + 6.0)))
    assert (table["lat_deg"].iloc[3], table["fix"].iloc[3]) == (35.0003, "single")


def test_heights_and_datum_of_a_track(tmp_path):
    """The separation of geoid and ellipsoid is no height; in Texas NAD27 lies 40 m from WGS 84."""
    path = tmp_path / "track.csv"
    head = "DATE_TIME_UTC,Latitude (NAD27),Longitude (NAD27),Geoid-ellipsoid separation,Ellipsoidal height"
    path.write_text(f"{head}\n2024-06-12 10:00:00,30.2,-98.5,-27.1,120.5\n")
    log = read_track_table([path], TrackOptions())
    assert log.positions["h_ell_m"].tolist() == [120.5]
    assert 2e-4 < abs(log.positions["lon_deg"][0] + 98.5) < 5e-4
    assert "are in NAD27, as the file states" in " ".join(log.report.notes)


def test_a_deeper_export_in_other_units_or_without_places(tmp_path):
    """59 degrees are Fahrenheit, and then depths are feet; 0, 0 is no place."""
    path = tmp_path / "depths.csv"
    path.write_text("".join(f"51.0{k},13.7{k},8.2,59.0,{UNIX_MS + k}\n" for k in range(9)))
    with pytest.raises(InputError, match="water of 59 degrees"):
        read_deeper([path], TrackOptions())
    path.write_text("lat,lon,depth_ft,temperature,time\n" + path.read_text())
    assert recognise(path) != "deeper"
    path.write_text(deeper(9) + "0.0,0.0,1.0,15.0,1722032348825\n")
    assert len(read_deeper([path], TrackOptions()).soundings) == 9


def test_points_are_no_deeper_export(tmp_path):
    """Five columns of a cloud: no milliseconds of this century stand in the last one."""
    path = tmp_path / "cloud.csv"
    path.write_text("35.16,139.61,11.3,29.0,12\n" * 20, encoding="utf-8")
    assert recognise(path) == "xyz"


def test_a_track_and_depths_in_tables(tmp_path):
    """A row without a value is counted; the heights are ellipsoidal because the column says so."""
    track, sonar = tmp_path / "gnss.txt", tmp_path / "sonar.txt"
    track.write_text(TRACK, encoding="utf-8")
    sonar.write_text(
        "Timestamp;Depth_in_Feet\n2022-05-30 20:14:00;10\n2022-05-30 20:14:01;0\n", encoding="utf-8"
    )
    assert (recognise(track), recognise(sonar)) == ("track_table", "depth_table")
    assert (stream_of("track_table", track), stream_of("depth_table", sonar)) == ("pos", "depth")
    table, report = read_positions("pos", [track], **POSITIONS)
    assert (len(table), report.losses) == (2, {"rows_without_values": 1})
    assert table[["lat_deg", "lon_deg", "h_ell_m"]].iloc[1].tolist() == [48.25, -68.25, 21.0]
    assert table["t_gps_s"].diff().iloc[1] == 2.0
    # heights of nothing stated are none
    track.write_text(TRACK.replace("EllipsoidalHeight", "Height"), encoding="utf-8")
    table, report = read_positions("pos", [track], **POSITIONS)
    assert table["h_ell_m"].isna().tolist() == [True, True]
    assert "No column of ellipsoidal heights: positions have none." in report.notes
    depths = read_depths([sonar]).depths
    assert depths["depth_m"].tolist() == pytest.approx([3.048])
    assert any("times state no zone" in note for note in describe(sonar).notes)
    track.write_text(TRACK[: TRACK.index("2022")] + "never;1;2;3;4\n", encoding="utf-8")
    with pytest.raises(InputError, match="no row with a time and values"):
        read_track_table([track], TrackOptions())


@pytest.mark.parametrize(
    ("head", "kind"),
    [
        ("time,lat,lon,depth", "table"),
        ("image,time,lat,lon", "table"),
        ("point,time,lat,lon", "table"),
        ("lat,lon,depth", "table"),
    ],
)
def test_other_tables_are_no_logs(tmp_path, head, kind):
    path = tmp_path / "a.csv"
    path.write_text(head + "\n" + ",".join("1" for _ in head.split(",")) + "\n", encoding="utf-8")
    assert recognise(path) == kind


def test_damaged_exports_are_read_or_refused(tmp_path, fuzz):
    read = partial(read_deeper, options=TrackOptions())
    for _, log in read_or_refused(fuzz, tmp_path / "fuzz.csv", read, deeper(60).encode()):
        assert log.depths["depth_m"].abs().max() < 11_034
    fuzz.check(read=0.9, troubled=0.2)


@pytest.mark.real
def test_real_loggers(data_dir):
    """Rows, limits and times as pandas reads them (README of each folder)."""
    today = data_dir / "today"
    log = read_deeper([next((today / "deeper_csv").glob("*.csv"))], TrackOptions())
    depth, lat = log.soundings["depth_m"], log.soundings["latitude"]
    assert (len(depth), depth.min(), depth.max(), depth.median()) == (2068, 2.768, 18.056, 11.114)
    assert [round(x, 6) for x in (lat.min(), lat.max())] == [35.160759, 35.165169]
    assert log.soundings["time"].iloc[[0, -1]].str[:23].tolist() == [
        "2024-07-26T22:17:28.825",
        "2024-07-27T04:48:47.541",
    ]
    (gnss,), (sonar,) = (
        list((today / "hydroblock_gnss_sonar").glob(f"*_{n}.txt")) for n in ("gnss", "sonar")
    )
    table, _ = read_positions("pos", [gnss], **POSITIONS)
    assert (len(table), table["h_ell_m"].min(), table["h_ell_m"].max()) == (3601, 20.3, 25.0)
    depths = read_depths([sonar]).depths
    depth = depths["depth_m"]
    assert (len(depth), depth.min(), depth.max(), depth.median()) == (3594, 2.1, 4.9, 4.6)
    for name, kind in (("test.DAT", "humminbird"), ("B000.SON", "humminbird"), ("B000.IDX", "humminbird")):
        assert recognise(today / "humminbird_998" / name) == kind
    with pytest.raises(InputError, match=r"a recording of a Humminbird.*by PINGMapper or SonarTRX"):
        soundings_table(today / "humminbird_998/B000.SON")
