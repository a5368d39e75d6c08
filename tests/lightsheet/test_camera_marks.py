"""The table of marks that the sensor's camera sees."""

import pytest

from thalweg.core import InputError
from thalweg.lightsheet.calibration import read_camera_marks

HEAD = "file,marker,corner,x_px,y_px,sigma_px\n"
ROW = "s.png,1,0,10.5,20.5,0.1\n"


def test_a_good_table(tmp_path):
    path = tmp_path / "marks.csv"
    path.write_text(HEAD + ROW + "s.png,1,1,11,21,0.1\n")
    table = read_camera_marks(path)
    assert table[["marker", "corner"]].to_numpy().tolist() == [[1, 0], [1, 1]]
    path.write_text("marker,corner,x_px,y_px,sigma_px\n1,0,10.5,20.5,0.1\n")
    assert read_camera_marks(path)["x_px"].tolist() == [10.5]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the file is empty"),
        (HEAD, "no row"),
        ("marker,x_px,y_px,sigma_px\n1,1,1,1\n", "columns missing: corner"),
        (HEAD + "s.png,1,0,10.5,,0.1\n", "'' in column y_px, row 1"),
        (HEAD + "s.png,1.5,0,10.5,20.5,0.1\n", "1.5 in column marker, row 1; expected a whole number"),
        (HEAD + "s.png,1,0,10.5,20.5,0\n", "sigma_px 0 in row 1"),
        (HEAD + ROW + ROW, "mark 1/0 stands twice"),
        (HEAD + ROW + ROW.replace("s.png,1", "t.png,2"), "marks of 2 pictures, such as s.png and t.png"),
    ],
)
def test_tables_that_are_wrong(tmp_path, text, words):
    path = tmp_path / "marks.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_camera_marks(path)
    assert str(path) in str(caught.value)
