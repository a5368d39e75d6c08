"""The description of a field: what is read, and that every mistake is told with its line."""

import numpy as np
import pytest

from thalweg.calibration.field import parse_field, read_field
from thalweg.core import ConfigError

GOOD = """\
thalweg_field: 1
markers: {dictionary: DICT_4X4_250, module_m: 0.012, sizes: [{ids: [60, 99], module_m: 0.016}]}
cones:
  - {name: C1, markers: [0, 7], half_angle_deg: 25.0, length_m: 0.70}
  - {name: C2, markers: [8, 15], half_angle_deg: 25.0, length_m: 0.70}
scale_bars:
  - {name: S1, from: "80/0", to: "81/0", length_m: 1.50012, sigma_m: 0.00003}
targets:
  - {name: T1, marker: 60, lat_deg: 51.0, lon_deg: 13.0, h_ell_m: 160.0, sigma_m: [0.008, 0.008, 0.012]}
antenna: {marker: 98, offset_m: -0.02, sigma_m: 0.001}
"""


def test_a_good_description(tmp_path):
    path = tmp_path / "field.yaml"
    path.write_text(GOOD)
    field = read_field(path)
    # both ends of the range have the other size, their neighbours have not
    assert [field.layout.module_of(i) for i in (59, 60, 80, 99, 100)] == [0.012, 0.016, 0.016, 0.016, 0.012]
    assert [c.markers for c in field.cones] == [tuple(range(8)), tuple(range(8, 16))]
    assert np.degrees(field.cones[0].half_angle_rad) == pytest.approx(25.0)
    assert (field.scale_bars[0].start, field.scale_bars[0].length_m) == ("80/0", 1.50012)
    assert field.targets[0].sigma_m == (0.008, 0.008, 0.012)
    assert field.boat_markers == {98}
    assert (field.cone_of(9), field.cone_of(60)) == ("C2", "")


def test_what_is_not_there_is_not_needed():
    field = parse_field("thalweg_field: 1\nmarkers: {module_m: 0.02}\n")
    assert (field.cones, field.scale_bars, field.targets, field.antenna) == ((), (), (), None)


@pytest.mark.parametrize(
    ("old", "new", "answer"),
    [
        ("thalweg_field: 1", "thalweg_field: 2", "line 1: thalweg_field: found 2"),
        ("DICT_4X4_250", "DICT_5X5_250", "line 2: markers.dictionary: unknown dictionary 'DICT_5X5_250'"),
        ("module_m: 0.012", "module_m: 12", "module_m: found 12; expected a number from 0.001 to 0.5"),
        ("cones:", "kegel:", "line 3: kegel: unknown key; expected one of thalweg_field, markers, cones"),
        ("[8, 15]", "[7, 15]", "line 5: cones[1]: marker 7 belongs to C1 and to C2"),
        ("[8, 15]", "[15, 8]", "from 15 to 8; expected the smaller id first"),
        ("[8, 15]", "[8, 300]", "marker 300; expected an id from 0 to 249"),
        ("name: C2", "name: C1", "the name 'C1' stands twice"),
        ("half_angle_deg: 25.0, ", "", "line 4: cones[0]: half_angle_deg is missing"),
        ('to: "81/0"', 'to: "81"', "line 7: scale_bars[0].to: '81' is no mark; expected marker/corner"),
        ('to: "81/0"', 'to: "80/0"', "the bar ends where it begins, at 80/0"),
        ("length_m: 1.50012", "length_m: 1500.12", "length_m: found 1500.12; expected a number from 0.01"),
        ("[0.008, 0.008, 0.012]", "0.01", "sigmas of east, north and up"),
        ("lat_deg: 51.0", "lat_deg: 5100.0", "lat_deg: found 5100.0; expected a number from -90 to 90"),
        ("marker: 98", "marker: antenna", "line 10: antenna.marker: marker 'antenna'"),
        ("cones:\n", "cones:\n  - 5\n", "line 4: cones[0]: found 5; expected keys with values"),
        ("antenna: {", "antenna: {{", "not valid YAML"),
    ],
)
def test_mistakes_are_told_with_their_line(old, new, answer):
    assert old in GOOD
    with pytest.raises(ConfigError) as caught:
        parse_field(GOOD.replace(old, new, 1))
    assert answer in str(caught.value)


def test_all_mistakes_at_once():
    text = (
        GOOD.replace("[8, 15]", "[15, 8]")
        .replace("length_m: 1.50012", "length_m: -1")
        .replace("51.0", "north")
    )
    with pytest.raises(ConfigError, match="3 mistakes in the description of the field"):
        parse_field(text)


def test_a_missing_file(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        read_field(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="begins with thalweg_field: 1"):
        parse_field("- 1\n")
