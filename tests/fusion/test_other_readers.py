"""Exports read by other programs' libraries: xarray-selafin, xugrid, swmm-api, ANUGA.

They are no part of the locked environment:

    pip install --target FOLDER xarray-selafin xugrid swmm-api netCDF4
    pip install --target FOLDER --no-deps anuga dill netCDF4 cftime
    THALWEG_READERS=FOLDER pytest tests/fusion/test_other_readers.py

py2dm and GDAL, which are, read the 2dm and the BAG in `test_mesh.py` and `test_measures_and_exports.py`.
"""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from tests.fusion.conftest import FRAME, GRID
from tests.fusion.test_measures_and_exports import model, sections  # noqa: F401
from thalweg.fusion import River
from thalweg.fusion.exports import export_river
from thalweg.settings.sections import Fusion, MeshSettings

READ = """
import json
import numpy as np
import xarray
import xugrid
from swmm_api.input_file import SwmmInput

selafin = xarray.open_dataset("mesh.slf", engine="selafin")
ugrid = xugrid.open_dataset("mesh.nc")
grid = ugrid.ugrid.grid
transects = SwmmInput.read_file("transects.inp")["TRANSECTS"]
print(json.dumps({
    "selafin_xy": np.column_stack([selafin.x, selafin.y]).tolist(),
    "selafin_z": selafin["B"].values.ravel().tolist(),
    "selafin_faces": (np.asarray(selafin.attrs["ikle2"]).reshape(-1, 3) - 1).tolist(),
    "ugrid_xy": np.column_stack([grid.node_x, grid.node_y]).tolist(),
    "ugrid_z": np.asarray(ugrid["mesh2d_node_z"]).ravel().tolist(),
    "ugrid_faces": np.asarray(grid.face_node_connectivity).tolist(),
    "transects": [[list(map(float, pair)) for pair in t.station_elevations] for t in transects.values()],
    "roughness": sorted({float(t.roughness_channel) for t in transects.values()}),
}))
"""


@pytest.fixture
def river(arc, banks):
    return River(flow=arc, banks=banks, frame=FRAME, crs=GRID)


def test_every_export_is_what_was_written(model, river, sections, tmp_path):  # noqa: F811
    folder = os.environ.get("THALWEG_READERS")
    if not folder:
        pytest.skip("set THALWEG_READERS to a folder with the readers (head of this file)")
    settings = Fusion(exports=["2dm", "selafin", "ugrid", "swmm"], mesh=MeshSettings(edge_m=1.5))
    facts = export_river(tmp_path, model, river, sections, settings)
    assert not facts["not_written"]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", READ],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": folder},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    read = json.loads(done.stdout.splitlines()[-1])
    nodes = [line.split()[2:] for line in (tmp_path / "mesh.2dm").read_text().split("\n") if line[:2] == "ND"]
    written = np.array(nodes, float)
    for name in ("selafin", "ugrid"):
        np.testing.assert_allclose(read[f"{name}_xy"], written[:, :2], atol=1e-3)
        np.testing.assert_allclose(read[f"{name}_z"], written[:, 2], atol=1e-3)
    assert read["selafin_faces"] == read["ugrid_faces"]
    assert len(read["ugrid_faces"]) == facts["mesh"]["faces"]
    assert len(read["transects"]) == len(sections)
    for transect, section in zip(read["transects"], sections, strict=True):
        known = np.isfinite(section.height_m)
        expected = np.column_stack([section.height_m, section.n_m.max() - section.n_m])[known][::-1]
        expected[:, 1] -= expected[0, 1]
        np.testing.assert_allclose(transect, expected, atol=2e-3)
    assert read["roughness"] == [settings.sections.manning]


READ_SDF = """
import json
import netCDF4
from anuga.file_conversion.sdf2pts import sdf2pts

sdf2pts("RASImport.sdf")
with netCDF4.Dataset("RASImport.pts") as file:
    found = {name: file[name][:].tolist() for name in ("points", "elevation")}
    origin = [float(file.getncattr(name)) for name in ("xllcorner", "yllcorner", "zone")]
print(json.dumps(found | {"origin": origin}))
"""


def test_anuga_reads_every_section_of_hec_ras(model, river, sections, tmp_path):  # noqa: F811
    """ANUGA asks for all records of the header, and for as many sections as it tells."""
    folder = os.environ.get("THALWEG_READERS")
    if not folder:
        pytest.skip("set THALWEG_READERS to a folder with the readers (head of this file)")
    export_river(tmp_path, model, river, sections, Fusion(exports=["hecras"]))
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", READ_SDF],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": folder},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    read = json.loads(done.stdout.splitlines()[-1])
    expected = [
        np.column_stack([section.places_m, section.height_m])[np.isfinite(section.height_m)][::-1]
        for section in sorted(sections, key=lambda section: section.s_m)
    ]
    places = np.column_stack([np.array(read["points"]) + read["origin"][:2], read["elevation"]])
    np.testing.assert_allclose(places, np.concatenate(expected), atol=1e-3)
    assert read["origin"][2] == 33
