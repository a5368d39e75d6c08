"""The summary of a campaign: which figures, with which units, from which file, and how they are printed."""

import json

import pandas as pd
import pytest

from thalweg.accuracy import summary_lines, summary_table
from thalweg.accuracy.summary import COLUMNS
from thalweg.clocks import stream_table
from thalweg.ingest import IntegrityReport
from thalweg.lidar.filters import reason_table

TRUTH = """\
quantity,points,value,unit
n,all,1000,1
rmse,all,3.5,m
predicted_rmse,all,0.04,m
normalised_squared_error,all,88.0,1
rmse,bare ground with gross errors,0.34,m
gross_errors,bare ground with gross errors,7,1
n,bare ground,800,1
rmse,bare ground,0.033,m
predicted_rmse,bare ground,0.031,m
normalised_squared_error,bare ground,1.07,1
independent_values,bare ground,12.5,1
consistent_low95,bare ground,0.37,1
consistent_high95,bare ground,1.94,1
share_of_points,bare ground,0.8,1
"""

REFERENCE = """\
registration,points,quantity,value,unit
as measured,all,n,2000,1
as measured,all,bias,0.12,m
as measured,all,rmse,0.31,m
as measured,without outliers,n,1900,1
as measured,without outliers,bias,0.055,m
as measured,without outliers,rmse,0.112,m
as measured,without outliers,nmad,0.067,m
as measured,without outliers,predicted_rmse,0.074,m
as measured,without outliers,ratio,0.66,1
as measured,without outliers,ratio_low95,0.65,1
as measured,without outliers,ratio_high95,2.1,1
with registration,all,rmse,0.9,m
with registration,without outliers,rmse,0.8,m
"""


@pytest.fixture
def files(tmp_path):
    """Tables as the rules before `summarise` leave them."""
    lidar = IntegrityReport(
        stream="lidar",
        format="pcap",
        files=["lidar.pcap"],
        time_scale="utc",
        synchronised=True,
        t_first_s=300_000_000.0,
        t_last_s=300_000_025.5,
        losses={"packets_missing": 7, "bytes_outside_packets": 1206},
    )
    depth = IntegrityReport(stream="depth", format="nmea", files=["echo.nmea"], time_scale="none")
    paths = {
        "streams": tmp_path / "streams.csv",
        "trajectory": tmp_path / "trajectory.json",
        "counts": tmp_path / "counts.csv",
        "truth": tmp_path / "truth_statistics.csv",
        "reference": tmp_path / "statistics.csv",
    }
    stream_table([lidar, depth]).to_csv(paths["streams"], index=False)
    paths["trajectory"].write_text(
        json.dumps(
            {
                "n_positions": 250,
                "n_positions_used": 240,
                "n_nodes_valid": 1250,
                "gaps": [[1.0, 2.5], [9.0, 4.0]],
            }
        )
    )
    reason_table([4321, 0, 0, 679, 0, 0, 0, 0, 0, 0]).to_csv(paths["counts"], index=False)
    paths["truth"].write_text(TRUTH)
    paths["reference"].write_text(REFERENCE)
    return paths


def values(table: pd.DataFrame) -> dict[str, tuple[float, str, str]]:
    """Quantity -> value, unit, source."""
    assert table["quantity"].is_unique
    return {row.quantity: (row.value, row.unit, row.source) for row in table.itertuples()}


def test_figures_of_a_real_campaign(files):
    table = summary_table(files["streams"], files["trajectory"], files["counts"])
    assert list(table.columns) == COLUMNS
    found = values(table)
    assert found["lidar: duration"] == (25.5, "s", "streams.csv")
    assert found["lidar: records lost or damaged"] == (7, "1", "streams.csv")
    assert found["lidar: bytes lost"] == (1206, "1", "streams.csv")
    assert found["depth: bytes lost"] == (0, "1", "streams.csv")
    assert found["positions used"] == (96.0, "%", "trajectory.json")
    assert found["trajectory nodes with a valid pose"] == (1250, "1", "trajectory.json")
    assert found["gaps in the trajectory"] == (2, "1", "trajectory.json")
    assert found["gaps in the trajectory, together"] == (6.5, "s", "trajectory.json")
    assert found["lidar points decoded"] == (5000, "1", "counts.csv")
    assert found["  in the cloud"] == (4321, "1", "counts.csv")
    assert found["  nearer than the shortest range"] == (679, "1", "counts.csv")
    assert "  on the own boat" not in found  # reasons that removed nothing are not listed
    # nothing is said about accuracy where there is no truth
    assert not any("bare ground" in name or "consistent" in name for name in found)


def test_figures_of_a_twin_are_those_of_bare_ground(files):
    without = summary_table(files["streams"], files["trajectory"], files["counts"])
    table = summary_table(files["streams"], files["trajectory"], files["counts"], truth=files["truth"])
    added = values(table.iloc[len(without) :])
    source = "truth_statistics.csv"
    assert added == {
        "bare ground: RMSE against the truth of the twin": (0.033, "m", source),
        "bare ground: RMSE predicted": (0.031, "m", source),
        "bare ground: NEES": (1.07, "1", source),
        "  if sigmas are consistent: above (95 %)": (0.37, "1", source),
        "  if sigmas are consistent: below (95 %)": (1.94, "1", source),
        "  inside that band (1: yes, 0: no)": (1.0, "1", source),
        "bare ground: RMSE with gross errors": (0.34, "m", source),
        "bare ground: gross errors": (7.0, "1", source),
        "bare ground: share of all points": (80.0, "%", source),
    }


def test_figures_of_a_comparison_are_those_as_measured(files):
    without = summary_table(files["streams"], files["trajectory"], files["counts"])
    table = summary_table(
        files["streams"], files["trajectory"], files["counts"], reference=files["reference"]
    )
    added = values(table.iloc[len(without) :])
    source = "statistics.csv"
    assert added == {
        "reference, without outliers: points compared": (1900.0, "1", source),
        "reference, without outliers: mean distance": (0.055, "m", source),
        "reference, without outliers: RMSE": (0.112, "m", source),
        "reference, without outliers: NMAD": (0.067, "m", source),
        "reference, without outliers: RMSE predicted": (0.074, "m", source),
        "reference, without outliers: predicted / observed": (0.66, "1", source),
        "  95 % acceptance band, lower limit": (0.65, "1", source),
        "  95 % acceptance band, upper limit": (2.1, "1", source),
        "reference, all points: points compared": (2000.0, "1", source),
        "reference, all points: mean distance": (0.12, "m", source),
        "reference, all points: RMSE": (0.31, "m", source),
        "reference: outliers": (pytest.approx(5.0), "%", source),
    }


def test_no_positions_are_no_share(files):
    """INS-only campaigns have no GNSS positions."""
    files["trajectory"].write_text(
        json.dumps({"n_positions": 0, "n_positions_used": 0, "n_nodes_valid": 1250})
    )
    table = summary_table(files["streams"], files["trajectory"], files["counts"])
    assert values(table)["positions used"] == (0.0, "%", "trajectory.json")


def test_lines_are_aligned_and_numbers_readable():
    rows = [
        ("lidar: duration", 25.5, "s", "streams.csv"),
        ("lidar points: written", 2_012_345.0, "1", "counts.csv"),
        ("bare ground: RMSE against the truth of the twin", 0.0331, "m", "truth_statistics.csv"),
        ("heading", -12.25, "deg", "x"),
    ]
    lines = summary_lines(pd.DataFrame(rows, columns=COLUMNS))
    assert [line.split("  ")[-1].strip() for line in lines] == [
        "25.500 s",
        "2,012,345",
        "0.033 m",
        "-12.250 deg",
    ]
    # two blanks, 52 of text, one blank, 16 of number: units begin in one column, numbers end in one
    assert [line[:2] + line[2:54].rstrip() for line in lines] == [f"  {row[0]}" for row in rows]
    assert all(len(line[:71]) == 71 and line[70] in "0123456789" for line in lines)
    assert [line[71:] for line in lines] == [" s", "", " m", " deg"]


def test_every_quantity_fits_its_column(files):
    table = summary_table(
        files["streams"],
        files["trajectory"],
        files["counts"],
        reference=files["reference"],
        truth=files["truth"],
    )
    values(table)  # no quantity stands twice
    assert table["quantity"].str.len().max() <= 52
    lines = summary_lines(table[table["value"].notna()])
    assert all(line[70].isdigit() and line[71:72] in ("", " ") for line in lines)


def test_a_stream_without_times_is_printed(files):
    """A depth log without date has no duration; its empty number stopped the whole summary."""
    table = summary_table(files["streams"], files["trajectory"], files["counts"])
    table.to_csv(files["streams"].with_name("summary.csv"), index=False)
    lines = summary_lines(pd.read_csv(files["streams"].with_name("summary.csv")))
    (line,) = [line for line in lines if line.startswith("  depth: duration")]
    assert len(lines) == len(table)
    assert not any(character.isdigit() for character in line)


def test_images_and_riverbed_have_their_lines(files, tmp_path):
    """Check points and left-out lines say how well the survey knew: they stand in the summary."""
    images, bed = tmp_path / "adjustment.json", tmp_path / "validation.json"
    checks = {
        "points": 4,
        "rmse_mm": {"east": 8.0, "north": 4.0, "up": 42.0},
        "predicted_mm": {"east": 6.0, "north": 6.0, "up": 14.5},
        "normalised": 3.07,
    }
    images.write_text(json.dumps({"images": 11, "images_without_pose": 2, "check_points": checks}))
    bed.write_text(
        json.dumps({"lines": 5, "rmse_m": 0.057, "normalised_square": 1.04, "outside_95": 0.048, "n": 200})
    )
    table = summary_table(files["streams"], files["trajectory"], images=images, bed=bed)
    values = table.set_index("quantity")["value"]
    assert values["photographs without a pose"] == 2
    assert values["check points: RMSE up"] == pytest.approx(0.042)
    assert values["check points: RMSE up predicted"] == pytest.approx(0.0145)
    assert values["check points: NEES (1: as predicted)"] == 3.07
    assert values["riverbed: RMSE of left-out lines"] == 0.057
    assert values["riverbed: outside the interval of 95 %"] == pytest.approx(4.8)
    assert "lidar points decoded" not in values.index  # no lidar, no counts
    images.write_text(json.dumps({"images": 11, "images_without_pose": 0, "check_points": None}))
    few = summary_table(files["streams"], files["trajectory"], images=images).set_index("quantity")["value"]
    assert few["check points"] == 0


def test_fixes_and_soundings_that_were_refused_are_told(files, tmp_path):
    """Of raw GNSS and of a sounder; positions that nobody post-processed say nothing of fixes."""
    positions, soundings = tmp_path / "positions.json", tmp_path / "soundings.json"
    facts = {"fix_ratio": 0.9, "n_fixes_refused": {"baseline": 3, "float": 2}}
    facts |= {"baseline_m": 5325.0, "baseline_max_m": 5372.0}
    positions.write_text(json.dumps({"details": facts}))
    soundings.write_text(json.dumps({"by_reason": {"": 147, "spike": 2, "turn": 0}}))
    known = {"positions": positions, "soundings": soundings}
    table = summary_table(files["streams"], files["trajectory"], **known).set_index("quantity")
    assert table["value"]["GNSS epochs with fixed ambiguities"] == 90.0
    assert table["value"]["GNSS fixes that were not trusted"] == 5
    assert table["value"]["distance of the GNSS base, largest"] == 5.372
    assert table["value"]["georeferenced soundings"] == 147
    assert table["value"]["  left out: spike"] == 2
    assert "  left out: turn" not in table.index
    positions.write_text(json.dumps({"details": {}}))
    bare = summary_table(files["streams"], files["trajectory"], positions=positions)
    assert not bare["quantity"].str.contains("GNSS").any()
