"""Surveyed points of a bed: from the map grid into the world, and tables that are none."""

import numpy as np
import pytest
from pyproj import CRS

from thalweg.core import InputError, LocalFrame
from thalweg.ingest.tracks import read_bed_survey

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
UTM = "EPSG:25833"
HEAD = "east_m,north_m,h_ell_m,sigma_m"


def text(points: np.ndarray, sigma_m: float = 0.02, head: str = HEAD) -> str:
    rows = FRAME.to_map(points, CRS(25833))
    return "\n".join([head, *(f"{e:.4f},{n:.4f},{h:.4f},{sigma_m}" for e, n, h in rows.tolist())]) + "\n"


def points(n: int = 20) -> np.ndarray:
    return np.random.default_rng(4).uniform([-50, -50, -3], [50, 50, 0], (n, 3))


def test_points_of_all_files_come_into_the_world(tmp_path, saved):
    first, second = points()[:12], points()[12:]
    (tmp_path / "a.csv").write_text(text(first), encoding="utf-8-sig")
    lines = text(second, 0.05).splitlines()
    # another order of columns, blanks and a column more
    mixed = [", ".join([f"P{k}", *reversed(line.split(","))]) for k, line in enumerate(lines)]
    saved("b.csv", "\n".join(mixed) + "\n")
    found = read_bed_survey([tmp_path / "a.csv", tmp_path / "b.csv"], FRAME, UTM)
    # four digits in the files
    assert found.points_wcs_m == pytest.approx(points(), abs=1e-4)
    assert found.sigma_m.tolist() == [0.02] * 12 + [0.05] * 8


GOOD = text(points(3))
SWAPPED = "east_m,north_m,h_ell_m,sigma_m\n" + "".join(
    ",".join([row.split(",")[1], row.split(",")[0], *row.split(",")[2:]]) + "\n" for row in GOOD.split()[1:]
)


@pytest.mark.parametrize(
    ("content", "answer"),
    [
        ("", r"the file is empty; expected a table"),
        (HEAD + "\n", r"0 points; expected at least 3"),
        (GOOD.replace("sigma_m", "quality"), r"columns east_m.*quality; expected a table with the columns"),
        (GOOD + "1.0,x,3.0,0.02\n", r"csv:5: 'x' in column north_m"),
        (GOOD + "1.0,,inf,0.02\n", r"csv:5: no number in column north_m, and 1 more such cells"),
        (GOOD.replace("0.02", "0"), r"csv:2: no standard deviation above 0 in column sigma_m, and 2 more"),
        (GOOD.replace("3772", "4772"), r"points up to 100 km from campaign.origin"),
        (GOOD.replace(",29", ",89"), r"\+\d{3} m from its height"),
        ("\x00\xff", r"zero bytes; expected a table as text"),
    ],
)
def test_what_is_no_bed_is_refused_with_its_place(saved, content, answer):
    assert content != GOOD
    path = saved("bed.csv", content.encode("latin-1"))
    with pytest.raises(InputError, match=answer) as caught:
        read_bed_survey([path], FRAME, UTM)
    assert "bed.csv" in str(caught.value)


def test_what_a_table_says_itself_is_followed(tmp_path, saved):
    """Another name, another separator, another unit: the same points."""
    saved("a.csv", GOOD)
    rows = [[float(x) for x in row.split(",")] for row in GOOD.split()[1:]]
    lines = [";".join(f"{v / 0.3048:.6f}".replace(".", ",") for v in row) for row in rows]
    saved("b.csv", "\n".join(["Easting [ft];Northing [ft];Elevation [ft];SD [ft]", *lines]))
    one, other = (read_bed_survey([tmp_path / name], FRAME, UTM) for name in ("a.csv", "b.csv"))
    assert other.points_wcs_m == pytest.approx(one.points_wcs_m, abs=1e-6)
    assert other.sigma_m == pytest.approx(one.sigma_m, abs=1e-6)


def test_a_missing_file_and_swapped_axes_are_named(tmp_path, saved):
    with pytest.raises(InputError, match="file not found"):
        read_bed_survey([tmp_path / "none.csv"], FRAME, UTM)
    saved("bed.csv", SWAPPED)
    with pytest.raises(Exception, match=r"swapped|area of use|outside of"):
        read_bed_survey([tmp_path / "bed.csv"], FRAME, UTM)
