"""Commands around calibrations: what they write, what they refuse, and what they print of other files."""

import json
from pathlib import Path

import numpy as np
import pytest

from thalweg.calibration import interior_calibration, read_camera, write_mounts
from thalweg.cli import main
from thalweg.clocks import ClockModel
from thalweg.core import Camera
from thalweg.core.calibration import Calibration, Source, lever_block, read_calibration, write_calibration
from thalweg.settings.sections import Mounts

SOURCE = Source(run="yard", method="bundle adjustment")
BROWN = Camera(
    model="perspective",
    size_px=(1600, 1200),
    name="boat",
    parameters=np.array([1295.0, 1294.0, 804.4, 597.1, -0.06, 0.08, 4e-4, -3e-4, -0.02]),
    cov=np.diag(np.r_[np.full(4, 0.1), np.full(5, 1e-4)] ** 2),
)
FISHEYE = Camera(
    model="fisheye",
    size_px=(1920, 1208),
    name="boat",
    parameters=np.array([1176.9, 1177.7, 962.7, 613.2, -0.054, -0.078, 0.096, -0.052]),
    cov=np.diag(np.r_[np.full(4, 0.1), np.full(4, 1e-4)] ** 2),
)
SIGMAS = ["--sigma", "focal_px=0.1", "--sigma", "centre_px=0.1", "--sigma", "distortion=0.0001"]
FIELD = """\
thalweg_field: 1
markers: {dictionary: DICT_4X4_50, module_m: 0.012, sizes: [{ids: [40, 49], module_m: 0.016}]}
cones: [{name: C1, markers: [0, 7], half_angle_deg: 25.0, length_m: 0.70}]
scale_bars: [{name: S1, from: "20/0", to: "21/0", length_m: 1.50012, sigma_m: 0.00003}]
targets:
  - {name: T1, marker: 44, lat_deg: 51.02801, lon_deg: 13.72102, h_ell_m: 160, sigma_m: [0.01, 0.01, 0.02]}
antenna: {marker: 38, offset_m: -0.020, sigma_m: 0.001}
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """What a command that refuses says."""
    capsys.readouterr()
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.out == ""
    return said.err


# ---------------------------------------------------------------- cameras of other programs


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("camera", [BROWN, FISHEYE], ids=lambda c: c.model)
@pytest.mark.parametrize(
    ("to", "name"), [("colmap", "cameras.txt"), ("opencv", "cam.yaml"), ("opencv", "cam.json")]
)
def test_a_camera_goes_out_and_comes_back(camera, to, name, capsys):
    write_calibration(Path("ours.yaml"), interior_calibration(camera, SOURCE, block="reference"))
    assert main(["export-camera", "ours.yaml", name, "--to", to]) == 0
    assert "without the sigmas and correlations of ours.yaml" in capsys.readouterr().out
    other = read_camera(Path(name))
    assert (other.model, other.size_px) == (camera.model, camera.size_px)
    assert main(["import-camera", name, "back.yaml", *SIGMAS, "--block", "reference"]) == 0
    back, ours = read_calibration(Path("back.yaml")), read_calibration(Path("ours.yaml"))
    assert back.labels == ours.labels
    # 0.5 pixels off and on round the last digit of cx
    np.testing.assert_allclose(back.values, ours.values, rtol=1e-15)
    np.testing.assert_allclose(back.sigmas, ours.sigmas)


@pytest.mark.usefixtures("here")
def test_what_no_camera_file_can_be_made_of(capsys):
    write_calibration(Path("ours.yaml"), interior_calibration(BROWN, SOURCE))
    assert main(["export-camera", "ours.yaml", "cam.yaml", "--to", "opencv"]) == 0
    before = Path("cam.yaml").read_bytes()
    assert "exists already" in refused(capsys, "export-camera", "ours.yaml", "cam.yaml", "--to", "opencv")
    assert main(["export-camera", "ours.yaml", "cam.yaml", "--to", "opencv", "--force"]) == 0
    assert Path("cam.yaml").read_bytes() == before
    said = refused(capsys, "export-camera", "ours.yaml", "cam.yaml", "--to", "colmap", "--force")
    assert "'cam.yaml' for a file of colmap; expected one that ends in .txt" in said
    said = refused(capsys, "export-camera", "ours.yaml", "c.txt", "--to", "colmap", "--block", "boat")
    assert "no camera 'boat' in the calibration; expected one of camera" in said
    block = lever_block("antenna", [0.1, 0.0, -0.4])
    mast = Calibration(title="mast", blocks=(block,), cov=np.eye(3) * 1e-6, source=SOURCE)
    write_calibration(Path("mast.yaml"), mast)
    assert "Name the calibration of a camera" in refused(
        capsys, "export-camera", "mast.yaml", "c.txt", "--to", "colmap"
    )
    both = [interior_calibration(BROWN, SOURCE, block=name) for name in ("camera", "reference")]
    write_calibration(Path("both.yaml"), Calibration.merged(both, title="two", source=SOURCE))
    said = refused(capsys, "export-camera", "both.yaml", "c.txt", "--to", "colmap")
    assert "2 cameras in the calibration; expected one of camera, reference. Name one with --block" in said
    assert not Path("c.txt").exists()


@pytest.mark.usefixtures("here")
def test_imports_name_the_command_that_a_file_is_for(capsys):
    write_calibration(Path("ours.yaml"), interior_calibration(BROWN, SOURCE))
    main(["export-camera", "ours.yaml", "cameras.txt", "--to", "colmap"])
    Path("m.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    assert "Use `thalweg import-camera`" in refused(capsys, "import-calibration", "cameras.txt", "x.yaml")
    assert "Use `thalweg import-calibration`" in refused(capsys, "import-camera", "m.txt", "x.yaml")
    assert "this is a calibration file" in refused(capsys, "import-camera", "ours.yaml", "x.yaml")
    assert "State it: --sigma focal_px" in refused(capsys, "import-camera", "cameras.txt", "x.yaml")
    assert "exists already" in refused(capsys, "import-camera", "cameras.txt", "ours.yaml", *SIGMAS)
    Path("four.yaml").write_text("K: [500, 0, 320, 0, 500, 240, 0, 0, 1]\nD: [0.1, 0.01, 0.0, 0.001]\n")
    assert "and no distortion_model" in refused(capsys, "import-camera", "four.yaml", "x.yaml", *SIGMAS)
    words = ["import-camera", "four.yaml", "x.yaml", *SIGMAS, "--model", "fisheye"]
    assert "no size of the picture" in refused(capsys, *words)
    assert main([*words, "--size-px", "640", "480"]) == 0
    found = read_camera(Path("x.yaml"))
    assert (found.model, found.size_px) == ("fisheye", (640, 480))
    # k3 is exactly zero: it was held
    np.testing.assert_allclose(np.sqrt(np.diag(found.cov)), [0.1] * 4 + [1e-4, 1e-4, 0.0, 1e-4])


# ---------------------------------------------------------------- printed markers


@pytest.mark.usefixtures("here")
def test_printed_markers_of_a_field_and_of_a_size(capsys):
    Path("field.yaml").write_text(FIELD)
    said = refused(capsys, "print-markers", "a.pdf", "--field", "field.yaml", "--module-mm", "12")
    assert "both --field field.yaml and --module-mm 12; expected one of them" in said
    for size, words in (("0.1", "at least 2 mm"), ("19", "up to 18.2 mm"), ("nan", "nan"), ("-3", "-0.003")):
        assert words in refused(capsys, "print-markers", "a.pdf", "--ids", "1", "--module-mm", size)
    assert "in rising order" in refused(capsys, "print-markers", "a.pdf", "--ids", "3-1")
    # the dictionary of the field ends at 49
    assert "marker 50; expected 0 to 49" in refused(capsys, "print-markers", "a.pdf", "--field", "field.yaml")
    assert not Path("a.pdf").exists()
    words = ["print-markers", "sheets", "--ids", "39-40", "--field", "field.yaml"]
    assert main(words) == 0
    first = Path("sheets/marker_040.png").read_bytes()
    assert "marker_039.png exists already, and 1 more. Choose another name" in refused(capsys, *words)
    assert main([*words, "--force"]) == 0
    assert Path("sheets/marker_040.png").read_bytes() == first


# ---------------------------------------------------------------- descriptions


@pytest.mark.usefixtures("here")
def test_describe_prints_the_field(capsys):
    Path("cones.yaml").write_text(FIELD)
    assert main(["describe", "cones.yaml"]) == 0
    said = capsys.readouterr().out
    for words in (
        "field: description of a calibration field",
        "DICT_4X4_50, modules of 12 mm",
        "40 to 49: 16 mm",
        "C1    markers 0 to 7, half angle 25 deg, length 0.7 m",
        "S1    20/0 to 21/0  1.500120 ± 0.000030 m",
        "T1    marker 44  51.028010000 deg, 13.721020000 deg, 160.0000 m, sigma 0.01, 0.01, 0.02 m east",
        "marker 38, phase centre -0.0200 ± 0.0010 m out of the print",
    ):
        assert words in said
    Path("cones.yaml").write_text(FIELD.replace("length_m: 1.50012", "length_m: long"))
    assert "scale_bars[0].length_m" in refused(capsys, "describe", "cones.yaml")


@pytest.mark.usefixtures("here")
def test_describe_prints_the_clock(capsys):
    clock = ClockModel(
        offset_s=-2.347964,
        reference_s=304_773_426.158,
        cov=np.diag([0.002**2, 1e-5**2]),
        drift=-1.7e-5,
        jitter_s=0.0229,
        sigma_jitter_s=0.0014,
        source="kinematic run",
        notes=("one sentence",),
    )
    clock.write(Path("camera_clock.yaml"))
    assert main(["describe", "--json", "camera_clock.yaml"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["stream"] == "clock"
    assert found["details"]["offset"].startswith("-2347.964 ms, sigma 2.000 ms, at 2021-05-11T")
    assert found["details"]["drift"] == "-17.000 ppm, sigma 10.000 ppm"
    assert found["details"]["jitter"] == "22.900 ms a stamp, sigma 1.400 ms"
    assert found["details"]["source"] == "kinematic run"
    assert found["notes"] == ["one sentence"]
    Path("camera_clock.yaml").write_text("thalweg_clock: 9\n")
    assert "this is no clock file" in refused(capsys, "describe", "camera_clock.yaml")


@pytest.mark.usefixtures("here")
def test_describe_prints_the_mounts(capsys):
    section = Mounts().model_dump(mode="json")
    mounts = {name: {**section[name], "source": "campaign"} for name in ("lidar", "camera", "antenna")}
    rows = np.eye(6)
    rows[0, 1] = rows[1, 0] = 0.5
    mounts["camera"] |= {"sigma_axes": "ics", "correlation": rows.tolist(), "source": "yard"}
    mounts["lidar"]["correlation"] = np.eye(6).tolist()
    write_mounts(Path("mounts.json"), mounts)
    assert main(["describe", "mounts.json"]) == 0
    said = capsys.readouterr().out
    for words in (
        "lidar     from campaign\n",
        "phi_deg      -90.0000 ± 0.0090 deg",
        "x_m          0.00000 ± 0.00050 m",
        "camera    from yard, with correlations",
        "omega_deg    90 deg",
        "turned by    ± 1, 1, 1 deg about x, y, z of ics",
        "antenna   from campaign",
    ):
        assert words in said
    del mounts["antenna"]["sigma_lever_m"]
    write_mounts(Path("mounts.json"), mounts)
    assert "mounts.json: no mount (KeyError('sigma_lever_m'))" in refused(capsys, "describe", "mounts.json")
