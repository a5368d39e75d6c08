"""ASCII PCD clouds: good ones, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from thalweg.core import InputError, UnsupportedError
from thalweg.ingest.clouds import read_pcd

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


def test_points_and_fields(tmp_path: Path) -> None:
    cloud = read_pcd(written(tmp_path, HEAD + BODY))
    np.testing.assert_array_equal(cloud.xyz_m, [[1.5, 2, 3], [-1, 0.5, 2.25]])
    np.testing.assert_array_equal(cloud.fields["ring"], [0, 8])
    assert cloud.n_left_out == 1


def test_an_empty_cloud(tmp_path: Path) -> None:
    cloud = read_pcd(written(tmp_path, HEAD.replace("POINTS 3", "POINTS 0")))
    assert cloud.xyz_m.shape == (0, 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + BODY.rsplit("\n", 2)[0], "2 points where the head says 3"),
        (HEAD + BODY.replace("20 8", "20"), r"point 2 is '-1 0.5 2.25 20'"),
        (HEAD + BODY.replace("20 8", "20 x"), "point 2 is"),
        (HEAD.replace("x y z", "a b c") + BODY, "no fields x, y, z"),
        ("ply\nformat ascii 1.0\n", "no PCD head"),
        ("", "no PCD head"),
    ],
    ids=["cut", "short line", "word", "no coordinates", "another format", "empty"],
)
def test_bad_files_are_told(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_pcd(written(tmp_path, text))
    assert "a.pcd" in str(caught.value)


def test_binary_is_named(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedError, match="pcl_convert_pcd_ascii_binary"):
        read_pcd(written(tmp_path, HEAD.replace("ascii", "binary") + "\x00\x01"))
    with pytest.raises(UnsupportedError, match="COUNT"):
        read_pcd(written(tmp_path, HEAD.replace("COUNT 1", "COUNT 3") + BODY))


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="file not found"):
        read_pcd(tmp_path / "none.pcd")
