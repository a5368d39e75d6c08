"""Each row: what is wrong in an otherwise good campaign, where the message says it is, and the cure."""

import os
import re
import shutil
from pathlib import Path

import pytest

from tests.settings.conftest import in_order, mistakes_of
from thalweg.core import ConfigError
from thalweg.settings import load_campaign

# (changes at dotted paths, path in the message, words of found, expected and cure)
TABLE = [
    # keys and sections
    ("campaign.titel: x", "campaign.titel", "unknown key ... one of id, title ... Did you mean title?"),
    ("georeferencing.max_range: 9", "georeferencing.max_range", "Did you mean max_range_m?"),
    ("georeferencing.max_range_mm: 9", "georeferencing.max_range_mm", "Did you mean max_range_m, in metres?"),
    ("georeferencing.MAX_RANGE_M: 9", "georeferencing.MAX_RANGE_M", "Did you mean max_range_m?"),
    ("ppk.max_gap_s: 1", "ppk.max_gap_s", "belongs to orientation.max_gap_s ... move it there"),
    ("crs: 'EPSG:25833'", "crs", "belongs to campaign.crs"),
    ("lidars: {}", "lidars", "unknown key ... Did you mean lidar?"),
    ("qwertz: 1", "qwertz", "unknown key ... Remove it, or use one of: campaign, twin"),
    ("campaign.crs: <removed>", "campaign.crs", "missing ... projected ... Add the line `crs: EPSG:25833`"),
    ("campaign.origin: <removed>", "campaign.origin", "missing ... Add the line `origin: {lat_deg: …"),
    ("campaign.origin.h_ell_m: <removed>", "campaign.origin.h_ell_m", "missing ... llipsoidal"),
    ("campaign: <removed>", "campaign", "missing ... Add the line `campaign:"),
    ("lidar: null", "lidar", "the section is empty ... or remove the line"),
    ("lidar: VLP-16", "lidar", "found 'VLP-16' ... a section with keys ... indented"),
    ("mounts.lidar: [1, 2]", "mounts.lidar", "found [1, 2] ... a section with keys"),
    # kinds of values
    (
        "georeferencing.max_range_m: 100 m",
        "georeferencing.max_range_m",
        "'100 m' ... number alone ... metres",
    ),
    (
        "georeferencing.max_range_m: '99,5'",
        "georeferencing.max_range_m",
        "'99,5' ... Write a decimal point: 99.5",
    ),
    (
        "georeferencing.max_range_m: '''99'''",
        "georeferencing.max_range_m",
        "a number above 0 up to 250 (metres)",
    ),
    (
        "georeferencing.max_range_m: null",
        "georeferencing.max_range_m",
        "found nothing ... then the default holds",
    ),
    ("georeferencing.max_range_m: true", "georeferencing.max_range_m", "found true ... Write a number"),
    ("georeferencing.max_range_m: [1.0]", "georeferencing.max_range_m", "found [1.0] ... without brackets"),
    ("georeferencing.max_range_m: .nan", "georeferencing.max_range_m", "found nan ... a number"),
    ("ins.sigma_roll_deg: .inf", "ins.sigma_roll_deg", "found inf ... up to 45 (degrees)"),
    ("campaign.seed: 1.5", "campaign.seed", "found 1.5 ... whole number ... without decimals"),
    ("campaign.seed: '1'", "campaign.seed", "found '1' ... Remove the quotes"),
    ("campaign.seed: -3", "campaign.seed", "from 0 to 4294967295 ... without the sign: 3"),
    ("campaign.seed: 4294967296", "campaign.seed", "found 4294967296 ... from 0 to 4294967295"),
    ("campaign.crs: 25833", "campaign.crs", "found 25833 ... Write EPSG:25833"),
    ("campaign.title: ''", "campaign.title", "not empty"),
    ("campaign.title: 2021", "campaign.title", 'Put it in quotes: "2021"'),
    ("georeferencing.export_map: 'yes'", "georeferencing.export_map", "true or false without quotes"),
    ("georeferencing.export_map: 1", "georeferencing.export_map", "true or false"),
    ("lidar.model: VLP16", "lidar.model", "one of auto, VLP-16 ... Did you mean VLP-16?"),
    ("lidar.model: vlp-16", "lidar.model", "Did you mean VLP-16?"),
    ("figures.format: bmp", "figures.format", "unknown"),
    ("ppk.systems: [gps]", "ppk.systems[0]", "one of GPS, GLO ... Did you mean GPS?"),
    ("ppk.systems: []", "ppk.systems", "found 0 values ... at least one"),
    ("orientation.accept_fixes: fixed", "orientation.accept_fixes", "Write a list: [fixed]"),
    ("orientation.position_source: sbpp", "orientation.position_source", "Did you mean sbp?"),
    ("logs.lidar: raw/lidar_1.pcap", "logs.lidar", "Write a list: [raw/lidar_1.pcap]"),
    ("logs.lidar: [3]", "logs.lidar[0]", "found 3 ... text"),
    # identity
    ("campaign.id: Mulde 2021", "campaign.id", "small letters ... mulde_2021.yaml"),
    ("campaign.id: '2021'", "campaign.id", "beginning with a letter ... c2021"),
    ("campaign.id: other", "campaign.id", "in a file named good.yaml ... rename the file to other.yaml"),
    ("campaign.id: reproduction", "campaign.id", "names another target ... Choose another id"),
    # place
    ("campaign.crs: 'EPSG:99999'", "campaign.crs", "unknown to PROJ ... EPSG:32633"),
    ("campaign.crs: UTM 33", "campaign.crs", "is no CRS ... EPSG:32633, UTM at the origin"),
    ("campaign.crs: 'EPSG:4326'", "campaign.crs", "not projected ... map projection in metres"),
    ("campaign.crs: 'EPSG:4978'", "campaign.crs", "not projected"),
    ("campaign.crs: 'EPSG:2263'", "campaign.crs", "US survey foot ... in metres"),
    ("campaign.crs: 'EPSG:3857'", "campaign.crs", "stretches distances ... EPSG:32633, UTM"),
    ("campaign.crs: 'EPSG:31468'", "campaign.crs", "is on the ellipsoid Bessel ... EPSG:32633, UTM"),
    (
        "{campaign.crs: 'EPSG:27700', campaign.origin: {lat_deg: 51.33, lon_deg: 1.42, h_ell_m: 45}}",
        "campaign.crs",
        "is on the ellipsoid Airy ... EPSG:32631, UTM",
    ),
    ("campaign.crs: 'EPSG:32618'", "campaign.origin", "outside the area of use ... EPSG:32633"),
    (
        "campaign.origin: {lat_deg: 13.25, lon_deg: 51.05, h_ell_m: 0}",
        "campaign.origin",
        "outside the area of use ... look swapped ... lat_deg: 51.05",
    ),
    (
        "campaign.origin: {lat_deg: 0.891, lon_deg: 0.2313, h_ell_m: 0}",
        "campaign.origin",
        "looks like radians ... 51.05",
    ),
    ("campaign.origin: {lat_deg: 51.05, lon_deg: -13.25, h_ell_m: 0}", "campaign.origin", "East is positive"),
    (
        "campaign.origin.lat_deg: 5103.2",
        "campaign.origin.lat_deg",
        "NMEA degrees and minutes ... 51.05333333",
    ),
    ("campaign.origin.lat_deg: 113.2", "campaign.origin.lat_deg", "may be swapped"),
    ("campaign.origin.lon_deg: 413250.7", "campaign.origin.lon_deg", "degrees, not map coordinates"),
    ("campaign.origin.h_ell_m: 300000", "campaign.origin.h_ell_m", "looks like millimetres: write 300"),
    # ranges and units
    (
        "georeferencing.max_range_m: 120000",
        "georeferencing.max_range_m",
        "found 120000 ... looks like millimetres: write 120",
    ),
    (
        "georeferencing.min_range_m: -1",
        "georeferencing.min_range_m",
        "from 0 to 250 (metres) ... without the sign: 1",
    ),
    (
        "georeferencing.min_range_m: 130",
        "georeferencing.min_range_m",
        "max_range_m = 120 ... Swap the two numbers",
    ),
    ("georeferencing.min_range_m: 121", "georeferencing.min_range_m", "a minimum below the maximum"),
    ("lidar.data_port: 8308", "lidar.data_port", "both 8308 ... 2368"),
    ("lidar.data_port: 99999", "lidar.data_port", "from 1 to 65535"),
    ("orientation.max_gap_s: 500", "orientation.max_gap_s", "looks like milliseconds: write 0.5"),
    ("orientation.max_gap_s: 0", "orientation.max_gap_s", "above 0 up to 60 (seconds)"),
    ("ins.sigma_heading_deg: 0", "ins.sigma_heading_deg", "above 0 up to 45 (degrees)"),
    ("mounts.lidar.phi_deg: -1.57", "mounts.lidar.phi_deg", "looks like radians: write -90 ... -1.5701"),
    ("mounts.lidar.kappa_deg: 3.1416", "mounts.lidar.kappa_deg", "looks like radians: write 180"),
    ("mounts.lidar.omega_deg: 400", "mounts.lidar.omega_deg", "from -360 to 360 (degrees)"),
    (
        "mounts.antenna.lever_ics_m: [100, 0, -450]",
        "mounts.antenna.lever_ics_m",
        "below 10 m ... looks like millimetres: write [0.1, 0, -0.45]",
    ),
    (
        "mounts.lidar.sigma_lever_m: [0.5, 0.2, 0.1]",
        "mounts.lidar.sigma_lever_m",
        "below 0.5 m ... write [0.0005, 0.0002, 0.0001]",
    ),
    ("mounts.lidar.lever_ics_m: [1, 2]", "mounts.lidar.lever_ics_m", "found 2 values ... [x, y, z]"),
    ("mounts.lidar.lever_ics_m: [1, 2, 3, 4]", "mounts.lidar.lever_ics_m", "found 4 values ... 3 numbers"),
    ("mounts.lidar.lever_ics_m: 0.3", "mounts.lidar.lever_ics_m", "found 0.3 ... list of 3 numbers"),
    ("mounts.lidar.lever_ics_m: [1, a, 3]", "mounts.lidar.lever_ics_m[1]", "found 'a' ... a number"),
    ("mounts.lidar.lever_ics_m: <removed>", "mounts.lidar.lever_ics_m", "missing ... lever_ics_m: [x, y, z]"),
    ("mounts.antenna: <removed>", "mounts.antenna.lever_ics_m", "missing ... place of the antenna"),
    # input
    ("twin: {}", "twin", "both twin and logs are given ... exactly one"),
    ("logs: <removed>", "", "neither logs nor twin ... Add a section `logs:`"),
    ("logs: null", "logs", "the section logs is empty ... exactly one"),
    (
        "calibration.boat_camera.interior: raw/camera.yaml",
        "calibration.boat_camera.interior",
        "raw/camera.yaml: no such file ... an interior orientation at ... it holds base.sbp",
    ),
    (
        "calibration.boat_camera.interior: raw",
        "calibration.boat_camera.interior",
        "raw: this is a folder ... Name the file in it",
    ),
    (
        'calibration.boat_camera.interior: "camera\\0.yaml"',
        "calibration.boat_camera.interior",
        "a path ... Remove the character",
    ),
    ("calibration.boat_camera.interior: 3", "calibration.boat_camera.interior", "found 3"),
    (
        "calibration.reference_camera.interior: raw/base.sbp",
        "calibration.reference_camera.interior",
        "unknown key ... calibration.boat_camera.interior",
    ),
    ("logs.ins: [raw/boat.anp]", "logs.ins[0]", "no such file ... Did you mean boat.anpp in"),
    ("logs.ins: [raw/BOAT.ANPP]", "logs.ins[0]", "no such file ... Did you mean boat.anpp in"),
    ("logs.ins: [rax/boat.anpp]", "logs.ins[0]", "There is no folder ... Did you mean"),
    ("logs.ins: [raw/zzzzz]", "logs.ins[0]", "no such file ... it holds base.sbp"),
    ("logs.ins: [raw/*.anp]", "logs.ins[0]", "the pattern matches no file ... it holds base.sbp, boat.anpp"),
    ('logs.ins: ["raw/\\0"]', "logs.ins[0]", "expected a path ... Remove the character"),
    (f"logs.ins: [{'x' * 5000}]", "logs.ins[0]", "File name too long"),
    ("logs.ins: ['']", "logs.ins[0]", "not empty ... Write a value"),
    ("logs.ins: [raw]", "logs.ins[0]", "this is a folder ... raw/*"),
    ("logs.lidar: [raw/empty.pcap]", "logs.lidar[0]", "the file is empty ... Copy the log again"),
    (
        "logs.lidar: [raw/lidar_1.pcap, raw/../raw/lidar_1.pcap]",
        "logs.lidar[1]",
        "already named at logs.lidar[0] ... Remove one",
    ),
    ("logs.sbet: [raw/boat.anpp]", "logs.sbet[0]", "already named at logs.ins[0] ... one stream"),
    (
        "logs.gnss: {rover: [raw/rover.sbp], base: [raw/rover.sbp]}",
        "logs.gnss.base[0]",
        "already named at logs.gnss.rover[0] ... Remove it from base",
    ),
    ("logs.ins: <removed>", "logs.ins", "missing ... ANPP logs ... needed with a lidar or photographs"),
    (
        "logs.positions: <removed>",
        "logs.positions",
        "missing ... positions of the boat's ... position_source: sbp",
    ),
    (
        "{logs.positions: <removed>, logs.depth: <removed>, orientation.position_source: nmea}",
        "logs.positions",
        "missing ... position_source: nmea",
    ),
    (
        "mounts.echo_sounder: <removed>",
        "mounts.echo_sounder.lever_ics_m",
        "missing ... place of the echo_sounder",
    ),
    (
        "{orientation.position_source: sbp, logs.gnss: <removed>}",
        "logs.gnss.rover",
        "missing ... raw log of the boat's receiver ... position_source: pos",
    ),
    (
        "{orientation.position_source: sbp, logs.gnss: {rover: [raw/boat.obs]}}",
        "logs.gnss.rover",
        "RINEX files only ... position_source: ppk",
    ),
    ("orientation.position_source: sbet", "logs.sbet", "missing ... SBET files"),
    (
        "{orientation.position_source: sbet, logs.sbet: [raw/base.sbp]}",
        "logs.gps_week",
        "missing ... GPS week",
    ),
    ("orientation.position_source: ppk", "logs.gnss", "base antenna is missing ... base_from: sbp"),
    ("logs.gps_week: 200", "logs.gps_week", "modulo 1024: write 2248"),
    ("logs.depth_date: 12.05.2021", "logs.depth_date", "a date YYYY-MM-DD ... like 2021-05-12"),
    ("logs.depth_date: '2021-02-30'", "logs.depth_date", "no day of the calendar"),
    (
        "{logs.gnss.base_from: sbp, logs.gnss.base_ecef_m: [3909800.0, 920600.0, 4937000.0]}",
        "logs.gnss.base_from",
        "base_ecef_m and base_from ... Keep base_ecef_m",
    ),
    (
        "logs.gnss.base_ecef_m: [3909.8, 920.6, 4937.0]",
        "logs.gnss.base_ecef_m",
        "from the centre of the earth ... looks like kilometres",
    ),
    (
        "logs.gnss.base_ecef_m: [377000.0, 5657000.0, 300.0]",
        "logs.gnss.base_ecef_m",
        "Map or geodetic coordinates?",
    ),
    (
        "logs.gnss.base_llh: {lat_deg: 51.05, lon_deg: 3.25, h_ell_m: 300}",
        "logs.gnss.base_llh",
        "the base is 700 km from campaign.origin ... within 200 km",
    ),
    # twin
    ("{logs: <removed>, twin.size: tinny}", "twin.size", "one of tiny, demo, mulde ... Did you mean tiny?"),
    ("{logs: <removed>, twin.boat: {speed: 1}}", "twin.boat.speed", "unknown key ... speed_mps"),
    ("{logs: <removed>, twin.start_utc: noon}", "twin.start_utc", "not a UTC time ... 2021-05-12T08:31:07Z"),
    (
        "{logs: <removed>, twin.effects: {gnss_outages: [[3, -2]]}}",
        "twin.effects.gnss_outages[0][1]",
        "found -2 ... above 0",
    ),
    ("{logs: <removed>, twin: tiny}", "twin", "found 'tiny' ... a section with keys ... size"),
    # lists
    ("orientation.accept_fixes: [fixed, fixed]", "orientation.accept_fixes[1]", "stands twice"),
    ("ppk: {iono: dual-freq, frequencies: l1}", "ppk.iono", "two frequencies"),
    # area of interest, and what is made of the reference
    (
        "accuracy.area: {polygon: [[0, 0], [1, 1], [2, 2]]}",
        "accuracy.area.polygon",
        "enclose no area ... not on one line",
    ),
    (
        "accuracy.area: {polygon: [[377000, 5656000], [377100, 5656000], [377100, 5656100]]}",
        "accuracy.area.polygon[0]",
        "km from campaign.origin ... write frame: map",
    ),
    (
        "accuracy.area: {frame: map, polygon: [[0, 0], [100, 0], [100, 100]]}",
        "accuracy.area.polygon[0]",
        "in EPSG:25833 ... write frame: local",
    ),
    (
        "accuracy.area: {frame: map, polygon: [[5656700, 377300], [5656800, 377300], [5656800, 377400]]}",
        "accuracy.area.polygon[0]",
        "km from campaign.origin ... East comes first: swap",
    ),
    (
        "accuracy.area: {min_height_m: 5, max_height_m: 5}",
        "accuracy.area",
        "min_height_m 5 is not below max_height_m 5",
    ),
    (
        "accuracy.area: {polygon: [[0, 0], [4, 4], [4, 0], [0, 4]]}",
        "accuracy.area.polygon",
        "corner 1 to 2 ... corner 3 to 4 ... cross ... in their order along the outline",
    ),
    (
        "accuracy.area: {polygon: [[0, 0], [1, 1]]}",
        "accuracy.area.polygon",
        "found 2 values ... a list of 3 to 10000 values ... Write at least 3 values",
    ),
    (
        "accuracy.area: {frame: map, min_height_m: 0.15, max_height_m: 4}",
        "accuracy.area.max_height_m",
        "found 4, with frame: map and an origin at 300 m ... near 300 ... Then write frame: local",
    ),
    (
        "accuracy.area: {min_height_m: 301}",
        "accuracy.area.min_height_m",
        "found 301, with frame: local ... above campaign.origin ... Then write frame: map",
    ),
    (
        "accuracy.area: {polygon: [[0, 0], [9, 0], [9, 9]], max_height_m: 304}",
        "accuracy.area.max_height_m",
        "frame of the polygon, local",
    ),
    (
        "reference: {cell_m: 1.0, longest_edge_m: 0.1}",
        "reference",
        "longest_edge_m 0.1 is below 1.5 times cell_m 1 ... no triangle",
    ),
    (
        "accuracy.sections: {stations_m: []}",
        "accuracy.sections.stations_m",
        "found 0 values ... a list of 1 to 12 values ... at least one value",
    ),
    (
        "accuracy.sections: {stations_m: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]}",
        "accuracy.sections.stations_m",
        "found 13 values ... at most 12",
    ),
]


@pytest.mark.parametrize(
    ("changes", "path", "words"), TABLE, ids=[f"{i}-{row[1]}" for i, row in enumerate(TABLE)]
)
def test_message_names_place_and_cure(changes, path, words, write):
    spoilt = write(changes)
    error = mistakes_of(spoilt)
    at_path = [m for m in error.mistakes if m.dotted == path]
    assert at_path, f"no mistake at {path!r} in:\n{error}"
    line = str(at_path[0])
    assert re.search(in_order(words), line)
    assert line[:100] in str(error)  # a word of thousands of letters is cut in the whole
    assert line.startswith(f"{spoilt}:{at_path[0].line}: ")
    assert at_path[0].cure, "each mistake has a cure"


@pytest.mark.parametrize(
    "changes",
    [
        "logs.lidar: raw/lidar_1.pcap",
        "mounts.lidar.lever_ics_m: [1]",
        "campaign.id: Mulde 2021",
        "georeferencing.max_range_m: 120000",
        "campaign.crs: EPSG:2263x",
    ],
)
def test_one_mistake_gives_one_line(write, changes):
    """A wrong value is not reported a second time as missing or as out of place."""
    error = mistakes_of(write(changes))
    assert len(error.mistakes) == 1
    assert str(error).startswith("1 mistake in the campaign settings:\n")


def test_all_mistakes_come_at_once(write):
    """Faults of form do not hide faults of content: wrong types, missing files, CRS and units together."""
    error = mistakes_of(
        write("""
            campaign.titel: x
            campaign.crs: EPSG:4326
            campaign.seed: one
            lidar.model: HDL
            georeferencing.min_range_m: 200
            logs.ins: [raw/boat.anp]
            logs.depth: [raw/empty.pcap]
            logs.gps_week: x
            mounts.lidar.phi_deg: -1.57
            mounts.lidar.sigma_phi_deg: -1
            mounts.antenna.lever_ics_m: [100, 0, -450]
            orientation.position_source: sbet
        """)
    )
    expected = """campaign.titel campaign.crs campaign.seed lidar.model georeferencing.min_range_m logs.ins[0]
        logs.depth[0] logs.gps_week logs.sbet mounts.lidar.phi_deg mounts.lidar.sigma_phi_deg
        mounts.antenna.lever_ics_m"""
    assert {m.dotted for m in error.mistakes} == {*expected.split()}
    assert str(error).startswith(f"{len(error.mistakes)} mistakes in the campaign settings:\n")
    assert len(str(error).splitlines()) == 1 + len(error.mistakes)
    lines = [m.line for m in error.mistakes]
    assert lines == sorted(lines)
    assert isinstance(error, ConfigError)


def test_lines_are_those_of_the_file(write):
    path = write("{georeferencing.max_range_m: -2, logs.lidar: [raw/lidar_1.pcap, raw/lidar_3.pcap]}")
    rows = path.read_text().splitlines()
    told = {m.path[0]: rows[m.line - 1].strip() for m in mistakes_of(path).mistakes}
    assert told == {"georeferencing": "max_range_m: -2", "logs": "- raw/lidar_3.pcap"}


def test_a_code_receiver_never_fixes(write):
    """`single_frequency` with fixed solutions only would leave no position at all."""
    error = mistakes_of(
        write("{logs: <removed>, twin: {gnss: {mode: single_frequency}}, orientation.position_source: pos}")
    )
    assert [m.dotted for m in error.mistakes] == ["orientation.accept_fixes"]
    assert "Write accept_fixes: [single]" in str(error)


@pytest.mark.parametrize("source", ["sbet", "nmea", "gpx", "ppk"])
def test_twin_sources(write, source):
    """The twin writes neither an SBET, nor positions in NMEA or GPX; raw observations it does."""
    path = write(f"{{logs: <removed>, twin: {{}}, orientation.position_source: {source}}}")
    if source == "ppk":
        assert load_campaign(path).orientation.position_source == "ppk"
        return
    error = mistakes_of(path)
    assert [m.dotted for m in error.mistakes] == ["orientation.position_source"]
    assert "expected pos, sbp, ppk or ins" in str(error)


@pytest.mark.parametrize("angle", [1.5701, -1.56, 1.5, 3.0, 0.79001, 90.0, 0.0, -1.571])
def test_angles_with_more_digits_are_degrees(write, angle):
    """Only a value that equals a multiple of pi/4 to its own digits is suspected of being radians."""
    path = write({"mounts.lidar.phi_deg": angle})
    if angle == -1.571:  # pi/2 rounded to three digits
        assert "radians" in str(mistakes_of(path))
    else:
        assert load_campaign(path).mounts.lidar.phi_deg == angle


def test_unreadable_log(write, monkeypatch):
    real_open = Path.open

    def refuse(self, *args, **kwargs):
        if self.name == "boat.anpp":
            raise PermissionError(13, "Permission denied")
        return real_open(self, *args, **kwargs)

    path = write()
    monkeypatch.setattr(Path, "open", refuse)
    assert "Permission denied" in str(mistakes_of(path))


@pytest.mark.parametrize("name", ["<b>", "{b}", "a<b", "{campaign}"])
@pytest.mark.parametrize("pattern", ["{}/boat.anpp", "{}/*.anpp", "*/boat.anpp"])
def test_names_in_which_snakemake_reads_wildcards_are_refused(write, survey, name, pattern):
    """Its own words on them are of rules and lines of the Snakefile."""
    (survey / name).mkdir()
    shutil.copy(survey / "raw/boat.anpp", survey / name)
    text = str(mistakes_of(write({"logs.ins": [pattern.format(name)]})))
    assert f"logs.ins[0]: the path {survey}" in text
    assert "expected names without < > { }, which Snakemake reads as wildcards. Rename" in text


def test_what_is_no_file_and_a_pattern_without_end_are_named(write, survey, monkeypatch):
    """A link to itself, a pipe that nobody fills, a whole disk, a folder of too many files."""
    raw = survey / "raw"
    (raw / "loop.anpp").symlink_to("loop.anpp")
    os.mkfifo(raw / "pipe.anpp")
    for name, words in (("loop", "a link that leads to no file"), ("pipe", "this is a pipe or a device")):
        text = str(mistakes_of(write(f"logs.ins: [raw/{name}.anpp]")))
        assert f"logs.ins[0]: raw/{name}.anpp: {words}; expected " in text
    with pytest.raises(ConfigError, match=r"pattern '/\*\*/\*' searches a whole disk.*raw/lidar/\*.pcap"):
        load_campaign(write("logs.ins: ['/**/*']"))
    monkeypatch.setattr("thalweg.settings.messages.MOST_FILES", 3)
    with pytest.raises(ConfigError, match="matches more than 3 files and folders"):
        load_campaign(write("logs.ins: [raw/**/*]"))
