"""A small made-up survey for the tests of the figures."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from scipy.spatial.transform import Rotation

from tests.core.conftest import trajectory_of
from thalweg.core import rotation_enu_body, rotation_opk
from thalweg.core.geometry import TriangleMesh
from thalweg.figures.calibration.field import cones_of
from thalweg.ingest import GNSS_POSITION
from thalweg.surface import BankFrame

T0_GPS_S = 178_649_913.4  # 2017-05-12T18:44:55.4 UTC, the example of core.timescales


def make_trajectory(n=400, length_m=100.0, azimuth_deg=70.0, invalid=(slice(150, 160),)):
    """Zigzag of +-6 m along an azimuth at 10 Hz."""
    along = np.linspace(0, length_m, n)
    aside = 6.0 * np.sin(along / 5.0)
    s, c = np.sin(np.deg2rad(azimuth_deg)), np.cos(np.deg2rad(azimuth_deg))
    position = np.stack([along * s + aside * c, along * c - aside * s, np.full(n, 1.5)], axis=1)
    valid = np.ones(n, dtype=bool)
    for part in invalid:
        valid[part] = False
    cov = np.diag([4e-4] * 3 + [4e-6] * 3)
    return trajectory_of(T0_GPS_S + 0.1 * np.arange(n), position, cov=cov, valid=valid)


def table_of(schema, n, **columns):
    frame = pd.DataFrame({name: np.full(n, np.nan) for name in schema.names})
    for name, values in columns.items():
        frame[name] = values
    return frame


@pytest.fixture
def trajectory():
    return make_trajectory()


@pytest.fixture
def positions(trajectory):
    lat, lon, h = trajectory.frame.to_geodetic(trajectory.position_wcs_m)
    n = len(lat)
    fix = np.full(n, "fixed", dtype=object)
    fix[40:60], fix[70:73] = "float", "single"
    sigma = {f"sigma_{a}_m": np.where(fix == "fixed", 0.02, 0.5) for a in ("east", "north", "up")}
    return table_of(
        GNSS_POSITION, n, t_gps_s=trajectory.t_gps_s, lat_deg=lat, lon_deg=lon, h_ell_m=h, fix=fix, **sigma
    )


@pytest.fixture
def bank(rng, trajectory):
    """Points of a sloping bank north of the track, ten times as dense at 50..64 m along it."""
    n = 40_000
    along = rng.uniform(0, 100, n)
    along[: n // 2] = rng.uniform(50, 64, n // 2)
    across = rng.uniform(9, 15, n)
    s, c = np.sin(np.deg2rad(70.0)), np.cos(np.deg2rad(70.0))
    points = np.stack([along * s - across * c, along * c + across * s, 0.5 * (across - 9)], axis=1)
    return SimpleNamespace(
        points=points,
        intensity=rng.uniform(0, 255, n),
        azimuth_rad=np.deg2rad(70.0 - 90.0),
        middle_along_m=57.0,
    )


BANK_SLOPE_RAD = np.deg2rad(30.0)


def make_plane_bank(*, length_m=60.0, height_m=8.0, cell_m=1.0):
    """A bank to the south of a river along east: its frame, and the mesh of its plane."""
    frame = BankFrame.of(
        [100.0, -20.0, 3.0], [0.0, np.sin(BANK_SLOPE_RAD), np.cos(BANK_SLOPE_RAD)], [0.0, 1.0, 0.0]
    )
    columns, rows = int(length_m / cell_m) + 1, int(height_m / cell_m) + 1
    along, up = np.meshgrid(
        np.linspace(-length_m / 2, length_m / 2, columns), np.linspace(-height_m / 2, height_m / 2, rows)
    )
    vertices = frame.to_wcs(np.stack([along.ravel(), up.ravel(), np.zeros(along.size)], axis=1))
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + columns], axis=1),
            np.stack([corner + 1, corner + columns + 1, corner + columns], axis=1),
        ]
    )
    return frame, TriangleMesh(vertices_m=vertices, faces=faces, sigma_m=np.full(len(vertices), 0.004))


def make_comparison(rng, *, n=20_000, mean_m=0.03, std_m=0.05, length_m=60.0, height_m=8.0):
    """Points at normal distances from that bank, with a few outliers and some left out at the border."""
    frame, mesh = make_plane_bank(length_m=length_m, height_m=height_m)
    distance = rng.normal(mean_m, std_m, n)
    distance[: n // 100] = rng.uniform(0.6, 1.5, n // 100)
    along = rng.uniform(-length_m / 2, length_m / 2, n)
    up = rng.uniform(-height_m / 2, height_m / 2, n)
    bank = np.stack([along, up, distance], axis=1)
    wcs = frame.to_wcs(bank)
    border = np.abs(along) > length_m / 2 - 0.5
    table = pd.DataFrame(
        {
            "t_gps_s": np.sort(rng.uniform(0.0, 40.0, n)),
            "east_m": wcs[:, 0],
            "north_m": wcs[:, 1],
            "up_m": wcs[:, 2],
            "range_m": rng.uniform(5.0, 30.0, n).astype(np.float32),
            "distance_m": distance,
            "normal_east": 0.0,
            "normal_north": np.sin(BANK_SLOPE_RAD),
            "normal_up": np.cos(BANK_SLOPE_RAD),
            "sigma_normal_m": std_m,
            "sigma_reference_m": 0.006,
            "sigma_3d_m": 1.7 * std_m,
            "at_border": border,
            "used": ~border,
            "outlier": ~border & (distance > 0.5),
        }
    )
    return SimpleNamespace(table=table, mesh=mesh, frame=frame, bank=bank, slope_rad=BANK_SLOPE_RAD)


@pytest.fixture(name="make_comparison")
def make_comparison_fixture():
    """The function `make_comparison`."""
    return make_comparison


@pytest.fixture
def made(rng):
    """A comparison of 20,000 points with a plane bank."""
    return make_comparison(rng)


# ---------------------------------------------------------------- a calibration field

PLACES = (
    ("C1", -4.2, 1.6, 1.1, 40.0), ("C2", -5.5, -0.4, 0.5, -50.0),
    ("C10", 4.6, 1.8, 0.7, -145.0), ("C4", 0.5, 5.4, 0.9, -90.0),
)  # fmt: skip
CONES = [
    "name", "apex_x_m", "apex_y_m", "apex_z_m", "axis_x", "axis_y", "axis_z", "half_angle_deg", "length_m",
]  # fmt: skip


@pytest.fixture
def cones():
    rows = []
    for name, x, y, z, bearing in PLACES:
        turn = np.deg2rad(bearing)
        rows.append((name, x, y, z, np.cos(turn), np.sin(turn), 0.0, 25.0, 0.7))
    return pd.DataFrame(rows, columns=CONES)


@pytest.fixture
def poses():
    rows = []
    for name, heading in (("position_1", 3.0), ("position_2", 20.0)):
        R = rotation_enu_body(0.01, -0.02, np.deg2rad(heading))
        for sensor, turn, lever in (
            ("camera", rotation_opk(np.pi / 2, 0, 0), [-0.25, -0.1, -0.18]),
            ("lidar", rotation_opk(0, -np.pi / 2, 0), [-0.35, 0.0, -0.25]),
        ):
            place = np.array([0.0, 0.0, 0.6]) + R @ lever
            rows.append((name, sensor, *place, *Rotation.from_matrix(R @ turn).as_quat()))
    return pd.DataFrame(rows, columns=["position", "sensor", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"])


def on_cones(rng, cones, *, n=300, noise_m=0.01, mean_m=0.0):
    """Points on all cones but C4 at two positions, displaced along the normal."""
    parts = []
    for name, cone in cones_of(cones).items():
        if name == "C4":
            continue
        for position in ("position_1", "position_2"):
            z, turn = rng.uniform(0.1, 0.7, n), rng.uniform(0.3, 2.5, n)
            s = rng.normal(mean_m, noise_m, n)
            c, sine = np.cos(cone.half_angle_rad), np.sin(cone.half_angle_rad)
            radius = z * np.tan(cone.half_angle_rad) + s * c
            local = np.stack([radius * np.sin(turn), radius * np.cos(turn), z - s * sine], axis=1)
            xyz = cone.apex_m + local @ cone.frame
            parts.append(
                pd.DataFrame(
                    {
                        "cone": name,
                        "position": position,
                        "ring": rng.integers(0, 16, n),
                        "x_m": xyz[:, 0],
                        "y_m": xyz[:, 1],
                        "z_m": xyz[:, 2],
                        "residual_m": s,
                        "used": np.arange(n) % 50 != 0,
                        "t_gps_s": 1e8 + np.sort(rng.uniform(0, 60, n)),
                    }
                )
            )
    return pd.concat(parts, ignore_index=True)


@pytest.fixture
def points(rng, cones):
    return on_cones(rng, cones)


def texts(figure):
    """All words of a figure, with plain spaces."""
    found = [t.get_text() for t in figure.findobj(lambda artist: hasattr(artist, "get_text"))]
    return " | ".join(found).replace("\N{NO-BREAK SPACE}", " ").replace("\n", " ")


def artists(figure, gid):
    return figure.findobj(lambda artist: artist.get_gid() == gid)


def drawn(figure):
    """The picture can be drawn, is not empty, and no word of it leaves the page."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    assert np.ptp(canvas.buffer_rgba()) > 200
    page, renderer = figure.bbox, canvas.get_renderer()
    for text in [t for t in words_of(figure) if t.get_text().strip()]:
        box = text.get_window_extent(renderer)
        # a pixel of rounding
        inside = box.x0 > -1.5 and box.y0 > -1.5 and box.x1 < page.x1 + 1.5 and box.y1 < page.y1 + 1.5
        assert inside, text.get_text()


def words_of(figure):
    """Titles, labels, legends and texts; without ticks, of which some are never drawn."""
    found = [*figure.texts, figure._suptitle, *(t for legend in figure.legends for t in legend.get_texts())]
    for ax in figure.axes:
        legend = ax.get_legend()
        found += ax.texts + ([] if legend is None else legend.get_texts())
        found += [ax._left_title] + ([ax.xaxis.label, ax.yaxis.label] if ax.axison else [])
    return found


@pytest.fixture
def look():
    """Helpers that look into a figure: ``texts``, ``artists``, ``drawn``."""
    return SimpleNamespace(texts=texts, artists=artists, drawn=drawn)


@pytest.fixture(name="on_cones")
def on_cones_fixture():
    """The function `on_cones`."""
    return on_cones
