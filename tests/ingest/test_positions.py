"""The sources of positions that a campaign can choose."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg.core import InputError, gps_from_unix, write_table
from thalweg.ingest import DEPTH, GNSS_POSITION, INS_STATE
from thalweg.ingest.registry import choose_tracks, read_depths, read_positions, recognise
from thalweg.ingest.registry.positions import positions_from_states

NOTHING: dict[str, Any] = {"base": [], "nav": [], "ppk": {}, "base_position": {}}


def states() -> pd.DataFrame:
    n = 5
    table = pd.DataFrame({name: np.arange(n, dtype=float) for name in INS_STATE.names})
    return table.assign(
        fix="3d", system_status=np.uint16(0), filter_status=np.uint16(0), t_gps_s=3e8 + np.arange(n)
    )


def test_positions_inside_ins_states(tmp_path):
    write_table(tmp_path / "states.parquet", states(), INS_STATE)
    table, report = read_positions("ins", [], states=tmp_path / "states.parquet", **NOTHING)
    assert report.stream == "positions"
    assert report.synchronised
    assert (report.t_first_s, report.t_last_s) == (3e8, 3e8 + 4)
    assert_array_equal(table["lat_deg"], np.arange(5.0))
    write_table(tmp_path / "positions.parquet", table, GNSS_POSITION)


def test_an_unknown_source_is_answered_with_the_known_ones(tmp_path):
    with pytest.raises(InputError, match="'gps'; expected pos, sbp, nmea, gpx, ppk, sbet or ins"):
        read_positions("gps", [], states=tmp_path / "x", **NOTHING)


def test_an_indefinite_covariance_does_not_pass(tmp_path):
    names = "latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdun(m) age(s)"
    lines = [f"%  GPST                  {names} ratio"]
    for second in range(20):
        correlated = 0.05 if second == 7 else 0.0  # sdne above both sigmas: indefinite
        lines.append(
            f"2021/05/12 08:31:{second:02d}.000 51.05 13.25 300.0 1 12 0.02 0.02 0.03 {correlated} 0 0 0 9.9"
        )
    path = tmp_path / "track.pos"
    path.write_text("\n".join(lines) + "\n")
    table, report = read_positions("pos", [path], states=tmp_path / "x", **NOTHING)
    assert report.counts["covariances_replaced"] == 1
    assert table["cov_en_m2"].abs().max() < 1e-6
    assert_allclose(positions_from_states(states())["sigma_up_m"], np.arange(5.0))


def test_of_tracks_of_the_same_time_the_best_is_taken(tmp_path):
    def track(name, first, quality):
        lines = [
            f"2021/05/12 08:31:{first + k:02d}.0 51.05{k * k:03d} 13.25 300.0 {quality} 12 .02 .02 .03"
            " 0 0 0 0 9"
            for k in range(20)
        ]
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        return tmp_path / name

    fixed, single, later = track("rover.pos", 0, 1), track("spp.pos", 0, 5), track("later.pos", 25, 5)
    kept, left = choose_tracks([single, fixed, later])
    assert kept == [fixed, later]
    assert left == {single: "of the same time as rover.pos, which has more fixed positions"}


@pytest.mark.real
def test_ppk_through_the_sections_of_a_campaign(data_dir, tmp_path):
    log = data_dir / "sbp_piksi_rtk_2017/2017-05-12-v1.1.26.sbp"
    table, report = read_positions(
        "ppk",
        [log],
        states=tmp_path / "x",
        base=[],
        nav=[],
        ppk={"systems": ["GPS"], "elevation_mask_deg": 10.0},
        base_position={"base_from": "sbp"},
    )
    fixes = table["fix"].value_counts()
    assert fixes["fixed"] == pytest.approx(378, abs=3)  # PROVENANCE: Q1 378, Q2 22
    assert fixes.sum() == 400
    assert report.synchronised


GPX = """<?xml version="1.0" encoding="UTF-8"?>
<gpx version="1.1" creator="x" xmlns="http://www.topografix.com/GPX/1/1"><wpt lat="1" lon="2"/><trk><trkseg>
<trkpt lat="51.05" lon="13.25"><ele>260.5</ele><time>2021-05-12T09:00:00Z</time>{more}<sat>9</sat></trkpt>
<trkpt lat="51.05001" lon="13.25"><ele>260.6</ele><time>2021-05-12T11:00:01+02:00</time>{more}</trkpt>
<trkpt lat="51.05002" lon="13.25"></trkpt></trkseg></trk></gpx>
"""


def test_a_track_in_gpx(tmp_path):
    """Ellipsoidal heights where the file says how high the geoid is; a point without a time is counted."""
    path = tmp_path / "track.xml"
    for more, heights in (
        ("<geoidheight>43.0</geoidheight><fix>dgps</fix>", [303.5, 303.6]),
        ("", [np.nan] * 2),
    ):
        path.write_text(GPX.format(more=more))
        assert recognise(path) == "gpx"
        table, report = read_positions("gpx", [path], states=None, **NOTHING)
        assert table["t_gps_s"].tolist() == gps_from_unix([1_620_810_000, 1_620_810_001]).tolist()
        assert table["lat_deg"].tolist() == [51.05, 51.05001]
        assert_allclose(table["h_ell_m"], heights)
        assert table["fix"].tolist() == ["dgnss" if more else "single"] * 2
        assert table["n_sats"].tolist() == [9, -1]
        assert report.losses == {"track_points_without_time": 1}
        assert report.notes == [
            *(
                []
                if more
                else ["Heights of GPX are above the geoid, and the file does not say how high that is."]
            ),
            "GPX states no standard deviations: orientation.sigma_position_m says them.",
            "Only tracks are read, not the 1 waypoints.",
        ]


@pytest.mark.parametrize(
    "text", ["<gpx><trk>", "<gpx><rte/></gpx>", GPX.format(more="").replace("51.05", "x")]
)
def test_a_gpx_without_a_track_is_refused(tmp_path, text):
    path = tmp_path / "track.gpx"
    path.write_text(text)
    with pytest.raises(InputError, match=r"no readable GPX|no XML|no track point with a time"):
        read_positions("gpx", [path], states=None, **NOTHING)


def test_depths_zones_and_waypoints_of_gpx(tmp_path):
    """Extensions of two programs, one in feet; a time without zone; a place that is no track."""
    path = tmp_path / "track.gpx"
    extension = '<extensions><x:e xmlns:x="{uri}"><x:{tag}>{value}</x:{tag}></x:e></extensions>'
    garmin = extension.format(uri="http://garmin/v2", tag="depth", value="2.5")
    other = extension.format(uri="http://sonar/1", tag="water_depth_ft", value="10")
    nothing = extension.format(uri="http://sonar/1", tag="Depth", value="0")
    rows = [
        f'<trkpt lat="51.05" lon="13.25"><ele>-2</ele><time>2024-06-12T10:00:0{k}{zone}</time>{more}</trkpt>'
        for k, (zone, more) in enumerate([("Z", garmin), ("", other), ("Z", nothing)])
    ]
    rows.append('<trkpt lat="51.05" lon="13.25"><time>1970-01-01T00:00:00Z</time></trkpt>')
    path.write_text(f'<gpx><wpt lat="1" lon="2"/><trk><trkseg>{"".join(rows)}</trkseg></trk></gpx>')
    log = read_depths([path])
    t0 = float(gps_from_unix(1_718_186_400))
    assert log.depths["t_gps_s"].tolist() == [t0, t0 + 1]
    assert log.depths["depth_m"].tolist() == pytest.approx([2.5, 3.048])
    write_table(tmp_path / "depths.parquet", log.depths, DEPTH)
    assert log.report.losses == {"depths_of_nothing": 1, "track_points_at_impossible_times": 1}
    notes = " ".join(log.report.notes)
    assert "1 times state no zone: taken as UTC" in notes
    assert "not the 1 waypoints" in notes
    assert "elevations are negative" in notes
    path.write_text(GPX.format(more=""))
    with pytest.raises(InputError, match="no depths in this recording"):
        read_depths([path])


def gpx_track(half_s: int, depth: str = "2.5") -> str:
    points = "".join(
        f'<trkpt lat="51.05" lon="13.{25 + half_s}{k:02d}"><time>2024-06-12T10:00:{k:02d}.{half_s}Z</time>'
        f"<extensions>{depth}</extensions></trkpt>"
        for k in range(20)
    )
    return f"<trk><trkseg>{points}</trkseg></trk>"


def test_tracks_of_the_same_time_are_named(tmp_path):
    path = tmp_path / "a.gpx"
    for others, told in (((0,), False), ((0, 5), True)):
        path.write_text(f'<gpx version="1.1">{"".join(map(gpx_track, others))}</gpx>')
        report = read_positions("gpx", [path], states=None, **NOTHING)[1]
        assert any("tracks are of the same time" in note for note in report.notes) == told


def test_a_remark_on_the_unit_of_depths_is_refused_unless_they_state_it(tmp_path):
    path, remark = tmp_path / "a.gpx", "<metadata><desc>Depths are in feet</desc></metadata>"
    path.write_text(f'<gpx version="1.1">{remark}{gpx_track(0, "<depth>10</depth>")}</gpx>')
    with pytest.raises(InputError, match="beside 'Depths are in feet'"):
        read_depths([path])
    path.write_text(f'<gpx version="1.1">{remark}{gpx_track(0, "<depth_ft>10</depth_ft>")}</gpx>')
    assert read_depths([path]).depths["depth_m"].tolist() == pytest.approx([3.048] * 20)
    path.write_text(f"""<gpx version="1.1">{gpx_track(0, "<depth_ft unit='m'>10</depth_ft>")}</gpx>""")
    with pytest.raises(InputError, match="depth ft in 'm'"):
        read_depths([path])
