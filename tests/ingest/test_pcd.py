"""PCD clouds: good ones, cut and damaged ones, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from thalweg.core import InputError
from thalweg.ingest.clouds import read_cloud

HEAD = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z intensity ring
SIZE 4 4 4 4 2
TYPE F F F F U
COUNT 1 1 1 1 1
WIDTH 3
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 3
DATA ascii
"""
BODY = "1.5 2 3 10 0\n-1 0.5 2.25 20 8\nnan nan nan 0 15\n"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "a.pcd"
    path.write_text(text)
    return path


def test_points_and_fields(tmp_path):
    cloud = read_cloud(written(tmp_path, HEAD + BODY))
    assert_array_equal(cloud.points, [[1.5, 2, 3], [-1, 0.5, 2.25]])
    assert_array_equal(cloud.intensity, [10, 20])
    assert_array_equal(cloud.ring, [0, 8])
    assert cloud.report.losses == {"points_not_finite": 1}


def test_remarks_that_matter(tmp_path):
    cloud = read_cloud(
        written(tmp_path, HEAD.replace("VERSION", "# offset 412000 5650000 0\nVERSION") + BODY)
    )
    assert any("'offset 412000 5650000 0'" in note for note in cloud.report.notes)
    with pytest.raises(InputError, match="units: feet"):
        read_cloud(written(tmp_path, HEAD.replace("VERSION", "# units: feet\nVERSION") + BODY))


def test_the_binary_form_with_padding_is_read_alike(tmp_path):
    """As PCL pads: a field without a meaning between, of several values, twice."""
    fields = [("xyz", "<f4", 3), ("a", "u1", 4), ("intensity", "<f4"), ("ring", "<u2"), ("b", "u1", 2)]
    rows = np.zeros(3, fields)
    rows["xyz"] = [[1.5, 2, 3], [-1, 0.5, 2.25], [np.nan, np.nan, np.nan]]
    rows["intensity"], rows["ring"] = [10, 20, 0], [0, 8, 15]
    head = (
        HEAD.replace("FIELDS x y z intensity ring", "FIELDS x y z _ intensity ring _")
        .replace("SIZE 4 4 4 4 2", "SIZE 4 4 4 1 4 2 1")
        .replace("TYPE F F F F U", "TYPE F F F U F U U")
        .replace("COUNT 1 1 1 1 1", "COUNT 1 1 1 4 1 1 2")
        .replace("ascii", "binary")
    )
    path = tmp_path / "a.pcd"
    path.write_bytes(head.encode() + rows.tobytes())
    cloud = read_cloud(path)
    assert_array_equal(cloud.points, [[1.5, 2, 3], [-1, 0.5, 2.25]])
    assert_array_equal(cloud.intensity, [10, 20])
    assert_array_equal(cloud.ring, [0, 8])
    path.write_bytes(head.encode() + rows.tobytes()[:-1])
    assert read_cloud(path).report.losses == {"points_missing": 1}


@pytest.mark.parametrize(
    ("text", "losses"),
    [
        (HEAD + BODY.rsplit("\n", 2)[0], {"points_missing": 1}),
        (HEAD + BODY.replace("20 8", "20"), {"damaged_lines": 1, "points_not_finite": 1}),
        (HEAD + BODY.replace("20 8", "20 x"), {"damaged_lines": 1, "points_not_finite": 1}),
    ],
    ids=["cut", "short line", "word"],
)
def test_what_is_missing_or_damaged_is_counted(tmp_path, text, losses):
    cloud = read_cloud(written(tmp_path, text))
    assert cloud.report.losses == losses
    assert_array_equal(cloud.points[0], [1.5, 2, 3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD.replace("x y z", "a b c") + BODY, "expected x, y, z, each once"),
        (HEAD.replace("POINTS 3", "POINTS 0"), "none of 0 points is finite"),
        (HEAD.replace("SIZE 4 4", "SIZE 4") + BODY, "no PCD head"),
        (HEAD.replace("POINTS 3", "POINTS many") + BODY, "no PCD head"),
        (HEAD.replace("DATA", "DATE") + BODY, "no PCD head"),
        (HEAD.replace("ascii", "binary_compressed"), "pcl_convert_pcd_ascii_binary"),
    ],
    ids=["no coordinates", "no points", "sizes", "words", "no data", "compressed"],
)
def test_bad_files_are_told(tmp_path, text, message):
    with pytest.raises(InputError, match=message) as caught:
        read_cloud(written(tmp_path, text))
    assert "a.pcd" in str(caught.value)
