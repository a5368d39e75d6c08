"""A zigzag of images with known poses, their predictions, and writers of other programs' formats."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS, Proj

from thalweg.core import ArrayF, LocalFrame, exp_rotation, opk_of, rotation_enu_body
from thalweg.images.imports import import_orientations
from thalweg.images.imports.poses import Imported
from thalweg.images.model import ImagePoses
from thalweg.settings.sections.images import FinishedOrientations

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=110.0)
UTM33 = CRS.from_epsg(25833)
FLIP = np.diag([1.0, -1.0, -1.0])
"""From ccs to x right, y up, z backwards, and back."""
EXACT = 1e-9
"""Text with 17 digits; quaternions and similarities in float64 at some hundred metres."""


@dataclass(frozen=True)
class Scene:
    """Truth in wcs."""

    images: tuple[str, ...]
    C: ArrayF
    R: ArrayF


def scene(n: int = 12) -> Scene:
    """Images 500 m away from the origin, looking to the bank at changing headings, pitched and rolled."""
    k = np.arange(n)
    C = np.column_stack([500.0 + 9.0 * k, -200.0 + 6.0 * (k % 3), 2.0 + 0.1 * np.sin(k)])
    body = rotation_enu_body(0.05 * np.sin(2 * k), 0.04 * np.cos(k), np.deg2rad(20.0 + 25.0 * np.sin(k)))
    # the camera looks 70 degrees to starboard, x of ccs backwards and y down
    look = np.deg2rad(70.0)
    R_ics_ccs = np.column_stack(
        [[-np.sin(look), np.cos(look), 0.0], [0.0, 0.0, 1.0], [np.cos(look), np.sin(look), 0.0]]
    )
    return Scene(tuple(f"run/IMG_{i:04d}.JPG" for i in k), C, body @ R_ics_ccs)


TRUTH = scene()


def predictions(
    rng: np.random.Generator | None = None,
    *,
    sigma_m: float = 0.3,
    sigma_deg: float = 0.5,
    truth: Scene = TRUTH,
) -> ImagePoses:
    """What clock, INS and mount tell: the truth with errors that all images share, and small own ones."""
    n = len(truth.images)
    shift, turn, sigma = np.zeros((n, 3)), np.zeros((n, 3)), np.array([0.02, 0.02])
    if rng is not None:
        sigma = np.array([sigma_m, sigma_deg])
        shift = sigma_m * (rng.normal(size=3) + 0.1 * rng.normal(size=(n, 3)))
        turn = np.deg2rad(sigma_deg) * (rng.normal(size=3) + 0.1 * rng.normal(size=(n, 3)))
    cov = np.diag(np.repeat(sigma * [1.0, np.deg2rad(1.0)], 3) ** 2)
    return ImagePoses(
        frame=FRAME,
        images=truth.images,
        t_gps_s=1e9 + np.arange(n),
        sigma_t_s=np.full(n, 0.02),
        oriented=np.ones(n, np.bool_),
        reasons=("",) * n,
        centre_wcs_m=truth.C + shift,
        R_wcs_ccs=exp_rotation(turn) @ truth.R,
        cov_pose_wcs=np.tile(cov, (n, 1, 1)),
        cov_next=np.zeros((n, 6, 6)),
        n_marks=np.zeros(n),
        rms_px=np.full(n, np.nan),
    )


def settings(**changes: Any) -> dict[str, Any]:
    """Section ``images.finished``."""
    return FinishedOrientations(**changes).model_dump()


def imported(
    *files: Path, given: ImagePoses | None = None, campaign: str | None = None, **changes: Any
) -> Imported:
    """Poses from files; if nothing else is said, of coordinates in wcs, beside predictions without errors."""
    section = settings(**{"crs": "world"} | changes)
    return import_orientations(files, given or predictions(), section, crs=campaign)


def geodetic() -> tuple[ArrayF, ArrayF]:
    """Longitude, latitude and height, and ``R_enu_ccs``."""
    lat, lon, h = FRAME.to_geodetic(TRUTH.C)
    return np.column_stack([lon, lat, h]), np.swapaxes(FRAME.R_wcs_enu(lat, lon), 1, 2) @ TRUTH.R


def in_grid(crs: CRS = UTM33) -> Scene:
    """Poses in a map grid, by the convergence that PROJ states: independent of the code under test."""
    places, R_enu_ccs = geodetic()
    out = np.empty_like(R_enu_ccs)
    for k, (lon, lat, _) in enumerate(places):
        gamma = np.deg2rad(Proj(crs).get_factors(lon, lat).meridian_convergence)
        c, s = np.cos(gamma), np.sin(gamma)
        # PROJ: grid north is gamma to the east of true north, so that bearing = azimuth - gamma
        out[k] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ R_enu_ccs[k]
    return Scene(TRUTH.images, FRAME.to_map(TRUTH.C, crs), out)


def angles_deg(R_place_ccs: ArrayF) -> ArrayF:
    """Omega, phi, kappa of aerial photogrammetry, degrees."""
    return np.rad2deg([opk_of(R @ FLIP) for R in R_place_ccs])


def table(
    path: Path,
    xyz: ArrayF | None = None,
    angles: ArrayF | None = None,
    head: str = "",
    separator: str = "\t",
    *,
    of: Scene = TRUTH,
    names: Any = None,
) -> Path:
    """Write a table of places and angles, and of what else stands in the rows of ``angles``."""
    xyz, angles = (of.C if xyz is None else xyz), (angles_deg(of.R) if angles is None else angles)
    rows = [
        separator.join([name, *(repr(float(v)) for v in (*x, *a))])
        for name, x, a in zip(names or of.images, xyz, angles, strict=True)
    ]
    path.write_text("\n".join([*([head] if head else []), *rows]) + "\n")
    return path


def quaternion(R: ArrayF) -> ArrayF:
    """Scalar first, by its definition in the axis and the angle."""
    v = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    w = np.sqrt(max(0.0, 1 + np.trace(R))) / 2
    if w > 0.1:
        return np.array([w, *(v / (4 * w))])
    axis = np.linalg.eigh((R + R.T) / 2)[1][:, -1]
    sine = v @ axis / 2
    angle = np.arctan2(sine, (np.trace(R) - 1) / 2)
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])


def write_colmap_text(folder: Path, of: Scene = TRUTH, points: bool = True) -> Path:
    """``cameras.txt`` and ``images.txt`` of poses in the model's frame."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text(
        "# Camera list\n7 OPENCV 720 540 582 583 361 270 -0.05 0.012 3e-4 -2e-4\n"
    )
    lines = ["# Image list with two lines of data per image:", "#   IMAGE_ID, QW, QX, ...", "#"]
    for k, name in enumerate(of.images):
        q, t = quaternion(of.R[k].T), -of.R[k].T @ of.C[k]
        lines.append(f"{k + 1} {' '.join(repr(float(v)) for v in (*q, *t))} 7 {name}")
        lines.append("10.5 20.25 3 30 40 -1 50.5 60 8" if points and k % 2 else "")
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    (folder / "points3D.txt").write_text("# 3D point list\n")
    return folder


LOCAL = 'LOCAL_CS["Local Coordinates (m)",LOCAL_DATUM["Local Datum",0],UNIT["metre",1]]'
SENSOR = """<sensor id="0" label="boat" type="frame"><resolution width="720" height="540"/>
<calibration type="frame" class="adjusted"><resolution width="720" height="540"/>{terms}</calibration>
{covariance}</sensor>"""
TERMS = {"f": 582.0, "cx": 1.5, "cy": -2.0, "b1": 0.5, "k1": -0.05, "k2": 0.012, "p1": 3e-4, "p2": -2e-4}


def write_metashape(
    path: Path,
    of: Scene = TRUTH,
    *,
    reference: str = LOCAL,
    chunk: bool = True,
    extra: str = "",
    covariance: tuple[ArrayF, ArrayF] | None = None,
    terms: Any = None,
    calibration: str = "",
    component: bool = False,
) -> Path:
    """Cameras XML of poses in the chunk's place (geocentric or local), in a chunk frame of another scale."""
    scale, R0, t0 = 3.7, exp_rotation(np.array([0.3, -1.1, 0.7])), of.C.mean(axis=0) + 0.25
    text = lambda a: " ".join(repr(float(v)) for v in np.ravel(a))  # noqa: E731
    rows = []
    for k, name in enumerate(of.images):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R0.T @ of.R[k], R0.T @ (of.C[k] - t0) / scale
        more = ""
        if covariance is not None:
            more = (
                f"<rotation_covariance>{text(covariance[1])}</rotation_covariance>"
                f"<location_covariance>{text(covariance[0])}</location_covariance>"
            )
        part = ' component_id="0"' if component else ""
        rows.append(
            f'<camera id="{k}" sensor_id="0"{part} label="{name}"><transform>{text(T)}</transform>{more}'
            "<orientation>1</orientation></camera>"
        )
    transform = (
        f"<transform><rotation>{text(R0)}</rotation><translation>{text(t0)}</translation>"
        f"<scale>{scale!r}</scale></transform>"
    )
    held = f'<components><component id="0">{transform}</component></components>' if component else transform
    found = "".join(f"<{key}>{value!r}</{key}>" for key, value in (terms or TERMS).items())
    stated = reference.replace('"', "&quot;")
    path.write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0">'
        '<chunk label="Chunk 1" enabled="true">'
        f"<sensors>{SENSOR.format(terms=found, covariance=calibration)}</sensors>"
        f"<cameras>{''.join(rows)}{extra}</cameras>{held if chunk else ''}"
        f"<reference>{stated}</reference></chunk></document>\n"
    )
    return path


def geocentric(of: Scene = TRUTH) -> Scene:
    """Poses in earth-centred coordinates."""
    return Scene(of.images, of.C @ FRAME.R_ecef_enu.T + FRAME.origin_ecef_m, FRAME.R_ecef_enu @ of.R)


def assert_poses(found: Imported | ImagePoses, atol_m: float = EXACT, atol: float = EXACT) -> None:
    poses = found.poses if isinstance(found, Imported) else found
    assert poses.oriented.all()
    np.testing.assert_allclose(poses.centre_wcs_m, TRUTH.C, rtol=0, atol=atol_m)
    np.testing.assert_allclose(poses.R_wcs_ccs, TRUTH.R, rtol=0, atol=atol)
