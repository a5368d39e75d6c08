"""What files state of their coordinates: units of three axes, GeoKeys, degrees, bands of rasters."""

import numpy as np
import pytest
import rasterio
from pyproj import CRS, Transformer
from rasterio import Affine

from thalweg.core import InputError, UnsupportedError, read_dsm
from thalweg.core.values import crs_of_geokeys, in_metres, onto_map, refuse_depths, same_heights

US_FOOT_M = 1200 / 3937
CORNER = (440_000.0, 5_640_000.0)
NORTH_UP = Affine(2.0, 0.0, CORNER[0], 0.0, -2.0, CORNER[1])
ROWS, COLUMNS = 20, 30


def relief():
    """20 x 30 heights of 100 to 103 m, all different."""
    row, column = np.indices((ROWS, COLUMNS))
    return 100.0 + 0.1 * column + 0.2 * np.sin(row)


def a_raster(path, *bands, transform=NORTH_UP, **told):
    """A GeoTIFF as others write them: units, scales, offsets, descriptions and a mask as given."""
    of_band = {
        name: told.pop(name) for name in ("units", "scales", "offsets", "descriptions") if name in told
    }
    mask, tags = told.pop("mask", None), told.pop("tags", {})
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(
            path,
            "w",
            driver="GTiff",
            height=ROWS,
            width=COLUMNS,
            count=len(bands),
            dtype=bands[0].dtype,
            transform=transform,
            crs=told.pop("crs", "EPSG:25833"),
            **told,
        ) as file,
    ):
        file.write(np.stack(bands))
        for name, values in of_band.items():
            setattr(file, name, values)
        file.update_tags(**tags)
        if mask is not None:
            file.write_mask(mask)
    return path


def keys(*rows):
    return [
        1,
        1,
        0,
        len(rows) // 2,
        *(n for k in range(0, len(rows), 2) for n in (rows[k], 0, 1, rows[k + 1])),
    ]


# ---------------------------------------------------------------- coordinate systems


@pytest.mark.parametrize(
    ("stated", "code", "factors"),
    [
        ((1024, 1, 3072, 25833), 25833, (1.0, 1.0)),
        # the key of the unit counts more than the system of heights, which has metres
        ((1024, 1, 3072, 25833, 4096, 5703, 4099, 9003), 25833, (1.0, US_FOOT_M)),
        ((1024, 1, 3072, 25833, 4099, 9002), 25833, (1.0, 0.3048)),
        ((3072, 2263, 4096, 6360), 32118, (US_FOOT_M, US_FOOT_M)),
        # UTM whose false easting is in feet, too
        ((1024, 1, 3072, 32633, 3076, 9002), 32633, (0.3048, 1.0)),
        ((0, 0, 1024, 1, 3072, 25833, 4099, 9001), 25833, (1.0, 1.0)),  # an empty key, as some write
        ((3076, 9003, 4099, 9003), None, (US_FOOT_M, US_FOOT_M)),
    ],
)
def test_keys_state_a_system_and_units(stated, code, factors):
    found = crs_of_geokeys(keys(*stated))
    assert found.factors == pytest.approx((factors[0], *factors), rel=1e-12)
    if code is None:
        assert found.crs is None
        return
    flat = found.crs.sub_crs_list[0] if found.crs.is_compound else found.crs
    lon, lat = (-73.9, 40.7) if code == 32118 else (13.7, 51.0)
    place = [Transformer.from_crs(4326, each, always_xy=True).transform(lon, lat) for each in (flat, code)]
    assert place[0] == pytest.approx(place[1], abs=1e-6)
    assert sum("converted to metres" in note for note in found.notes) == sum(x != 1.0 for x in factors)
    assert any("no unit of heights" in note for note in found.notes) == (
        4099 not in stated and 4096 not in stated
    )


def test_an_unknown_unit_is_refused():
    with pytest.raises(InputError, match=r"b\.las: GeoKey 4099: heights in the unit 32767 \(user-defined\)"):
        crs_of_geokeys(keys(3072, 25833, 4099, 32767), where="b.las")


def test_heights_of_an_unknown_datum_name_no_system():
    found = in_metres(
        CRS.from_wkt(
            f'COMPD_CS["x",{CRS(25833).to_wkt("WKT1_GDAL")},VERT_CS["unknown",VERT_DATUM["unknown",2005],'
            'UNIT["US survey foot",0.304800609601219],AXIS["Up",UP]]]'
        )
    )
    assert found.factors == pytest.approx((1.0, 1.0, US_FOOT_M), rel=1e-9)
    assert not found.crs.is_compound
    assert same_heights(found.crs, CRS("EPSG:25833+7837"))
    assert not same_heights(CRS("EPSG:25833+5783"), CRS("EPSG:25833+7837"))
    assert not same_heights(CRS(25833).to_3d(), CRS("EPSG:25833+7837"))


@pytest.mark.parametrize("code", ["EPSG:4258+7837", "EPSG:4979", "EPSG:4978"])
def test_degrees_become_the_zone_of_their_middle(code):
    crs = CRS(code)
    # one of them far away: the zone is that of most
    in_degrees = np.array([[13.70, 51.05, 150.0], [13.71, 51.06, 151.0], [30.70, 51.06, 152.0]])
    given = in_degrees
    if crs.is_geocentric:
        given = np.column_stack(Transformer.from_crs(4979, crs, always_xy=True).transform(*in_degrees.T))
    xyz, on_map, note = onto_map(given, crs)
    expected = Transformer.from_crs(4326, 32633, always_xy=True).transform(*in_degrees[:, :2].T)
    assert xyz == pytest.approx(np.column_stack([*expected, in_degrees[:, 2]]), abs=1e-3)
    assert "UTM zone 33N" in note
    assert same_heights(on_map, crs if crs.is_compound else CRS(25833).to_3d())


def test_zones_all_around_the_earth():
    """Both hemispheres, west and east, also counted beyond 180; at the limits of UTM, and beyond."""
    for lon, lat, code in (
        (-70.5, -33.0, 32719), (13.7, 0.1, 32633), (-180.0, 51.0, 32601), (179.9, 51.0, 32660),
        (350.0, 51.0, 32629), (-346.3, 51.0, 32633), (13.7, 84.0, 32633), (13.7, -80.0, 32733),
    ):  # fmt: skip
        found, on_map, _ = onto_map(np.array([[lon, lat, 7.0]]), CRS(4326))
        assert on_map.to_epsg() == code
        expected = Transformer.from_crs(4326, code, always_xy=True).transform((lon + 180) % 360 - 180, lat)
        assert found.tolist() == [pytest.approx([*expected, 7.0])]
    for lon, lat in ((13.7, 84.1), (13.7, -80.1), (360.1, 51.0), (-360.1, 51.0)):
        with pytest.raises(InputError, match="expected longitude and latitude in degrees, of a zone of UTM"):
            onto_map(np.array([[lon, lat, 7.0]]), CRS(4326))


def test_systems_whose_third_axis_counts_downwards_are_refused():
    for code in ("EPSG:5715", "EPSG:4258+5715"):
        with pytest.raises(InputError, match=r"a\.las: depths, positive downwards, .* MSL depth"):
            refuse_depths(CRS(code), "a.las")
    for crs in (None, CRS("EPSG:4258+7837"), CRS("EPSG:5714"), CRS(25833)):
        refuse_depths(crs, "a.las")


# ---------------------------------------------------------------- rasters

CENTIMETRES = np.rint(relief() * 100.0)
FEET = (relief() / 0.3048).astype(np.float32)


@pytest.mark.parametrize(
    ("band", "told", "note"),
    [
        (FEET, {"units": ["ft"]}, "stated in feet"),
        (FEET, {"descriptions": ["elevation [ft]"]}, "stated in feet"),
        (FEET, {"descriptions": ["elevation_ft"]}, "feet"),
        (FEET, {"descriptions": ["Height in feet"]}, "feet"),
        (FEET, {"tags": {"units": "feet"}}, "feet"),
        (FEET, {"tags": {"TIFFTAG_IMAGEDESCRIPTION": "DEM, elevations in feet"}}, "feet"),
        ((relief() / US_FOOT_M).astype(np.float32), {"units": ["US survey foot"]}, "in US survey feet"),
        (CENTIMETRES.astype(np.int16), {"units": ["cm"]}, "stated in centimetres"),
        (CENTIMETRES.astype(np.int16), {"scales": [0.01]}, "times 0.01 plus 0"),
        ((CENTIMETRES - 9000).astype(np.uint16), {"scales": [0.01], "offsets": [90.0]}, "times 0.01 plus 90"),
        ((relief() / US_FOOT_M).astype(np.float32), {"crs": "EPSG:25833+6360"}, "in US survey feet"),
    ],
)
def test_heights_become_metres_as_the_band_states(tmp_path, band, told, note):
    dsm = read_dsm(a_raster(tmp_path / "a.tif", band, **told))
    assert dsm.height_m == pytest.approx(relief(), abs=0.006 if band.dtype.kind in "iu" else 1e-4)
    assert any(note in text for text in dsm.notes)


@pytest.mark.parametrize(
    ("value", "kind", "told"),
    [
        (-3.4028235e38, np.float32, {}),
        (-32768, np.float32, {}),
        (-9999, np.float32, {"nodata": np.nan}),
        (np.nan, np.float32, {"nodata": -9999.0}),
        (-999, np.float32, {}),
        (-99, np.float32, {}),
        (255, np.float32, {}),
        (7, np.int16, {"nodata": 7, "units": ["cm"]}),
        (-32768, np.int16, {"units": ["cm"]}),
        (65535, np.uint16, {"scales": [0.01]}),
        (0, np.float32, {"mask": np.repeat(np.array([0, 255], np.uint8), [90, 510]).reshape(ROWS, COLUMNS)}),
    ],
)
def test_cells_without_a_height_are_none(tmp_path, value, kind, told):
    band = (relief() * (100 if kind != np.float32 else 1)).astype(kind)
    band[:3] = value
    dsm = read_dsm(a_raster(tmp_path / "a.tif", band, **told))
    assert np.isnan(dsm.height_m[:3]).all()
    assert np.isfinite(dsm.height_m[3:]).all()
    assert "90 of 600 cells without a height" in dsm.notes[0]


def test_the_band_of_heights_is_found_by_its_name(tmp_path):
    density, height = np.ones_like(relief()), relief()
    path = a_raster(tmp_path / "a.tif", density, height, descriptions=["density", "Elevation (m)"])
    dsm = read_dsm(path)
    assert dsm.height_m == pytest.approx(height)
    assert any("Band 2 (Elevation (m)) of 2 holds the heights" in text for text in dsm.notes)
    with pytest.raises(UnsupportedError, match=r"2 bands \(without names\)"):
        read_dsm(a_raster(tmp_path / "b.tif", density, height))


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"transform": Affine(2.0, 0.3, *CORNER[:1], 0.3, -2.0, CORNER[1])}, "turned or bent.*gdalwarp"),
        ({"units": ["degC"]}, "heights in 'degC'"),
        ({"descriptions": ["depth"]}, "depths"),
        ({"tags": {"positive": "down"}}, "depths"),
        ({"transform": Affine(1.0, 0.0, 5.65e6, 0.0, -1.0, 5.65e6)}, "expected coordinates in"),
        ({"crs": "EPSG:4258", "transform": Affine(1e-5, 0, 13.7, 0, -1e-5, 51.0)}, "degrees.*EPSG:32633"),
        ({"crs": None, "transform": Affine(1e-5, 0, 13.7, 0, -1e-5, 51.0)}, "look like degrees"),
    ],
)
def test_rasters_that_cannot_be_meant_are_refused(tmp_path, told, words):
    with pytest.raises(InputError, match=words):
        read_dsm(a_raster(tmp_path / "a.tif", relief(), **told))


def test_whole_numbers_of_zero_among_others_far_from_it_are_asked_about(tmp_path):
    band = np.rint(relief() * 10).astype(np.int16)
    band[:3] = 0
    with pytest.raises(InputError, match=r"90 of 600 cells are exactly 0 m.*--nodata 0"):
        read_dsm(a_raster(tmp_path / "a.tif", band, scales=[0.1]))
    low = np.rint(relief() - 101.0).astype(np.int16)  # a plain at the sea
    assert np.isfinite(read_dsm(a_raster(tmp_path / "b.tif", low)).height_m).all()
    few = relief()
    few[0, :5] = 0.0
    assert np.isnan(read_dsm(a_raster(tmp_path / "c.tif", few)).height_m).sum() == 5
