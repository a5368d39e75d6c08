"""A short twin that several tests look at: 4 s across a full hour, all logs, and its truth."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thalweg.core import ArrayF, LocalFrame, rotation_opk
from thalweg_lab.instruments import simulate_echo, simulate_gnss, simulate_ins, simulate_lidar, simulate_tls
from thalweg_lab.river import Material, Scene, simulate_scene
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import Motion, Voyage, simulate_voyage

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
R_ICS_SCS = rotation_opk(0.01, -np.pi / 2 + 0.02, -0.015)
LIDAR_M = np.array([-0.35, 0.02, -0.25])
ANTENNA_M = np.array([0.10, -0.05, -0.45])
ECHO_M = np.array([0.20, 0.03, 0.30])
SEED = 5
ELEVATION = np.deg2rad([-15.0, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15])
OFFSET_MM = np.array(
    [11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2]
)
"""Of the lasers of a VLP-16, by the manual."""


def rays_of(
    voyage: Voyage,
    t_gps_s: np.ndarray,
    azimuth_rad: np.ndarray,
    laser: np.ndarray,
    mount: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Origin and direction (n, 3) of shots, straight from the pose at each one's own time."""
    R_ics_scs, lever = mount
    a, e = azimuth_rad, ELEVATION[laser]
    unit = np.stack([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)], axis=1)
    height = np.stack([0 * a, 0 * a, OFFSET_MM[laser] / 1000], axis=1)
    R = voyage.R_wcs_ics(t_gps_s)
    origin = voyage.position_wcs_m(t_gps_s) + np.einsum("nij,nj->ni", R, height @ R_ics_scs.T + lever)
    return origin, np.einsum("nij,nj->ni", R, unit @ R_ics_scs.T)


@dataclass(frozen=True)
class Twin:
    """A simulated campaign."""

    config: TwinConfig
    folder: Path
    scene: Scene
    voyage: Voyage
    facts: dict[str, dict[str, Any]]

    def path(self, name: str) -> Path:
        return self.folder / name


def record_lidar(scene: Scene, out: Path, config: TwinConfig) -> dict[str, Any]:
    """The lidar log of another configuration, on a scene that exists."""
    return simulate_lidar(
        config,
        SEED,
        FRAME,
        scene,
        out,
        R_ics_scs=R_ICS_SCS,
        lever_ics_scs_m=LIDAR_M,
        out_shots=out.with_suffix(".parquet"),
        out_effects=out.with_suffix(".json"),
    )


def short(**changes: Any) -> TwinConfig:
    """The tiny twin, 4 s long, across a full hour; recordings may be shorter than a campaign's second."""
    length = {"duration_s": changes.pop("duration_s", 4.0)}
    return TwinConfig.of_size("tiny", **{"start_utc": "2021-05-12T08:59:58.25Z", **changes}).model_copy(
        update=length
    )


@pytest.fixture(scope="session")
def twin(tmp_path_factory):
    folder = tmp_path_factory.mktemp("twin")
    config = short(tls={"spacing_m": 0.2})
    scene = folder / "scene.npz"
    simulate_scene(config, SEED, scene)
    mesh = Scene.read(scene)
    simulate_voyage(config, SEED, FRAME, folder / "trajectory.parquet")
    facts = {
        "lidar": record_lidar(mesh, folder / "lidar.pcap", config),
        "ins": simulate_ins(config, SEED, FRAME, folder / "ins.anpp", out_effects=folder / "ins.json"),
        "gnss": simulate_gnss(
            config, SEED, FRAME, folder / "rover.sbp", folder / "ppk.pos", lever_ics_antenna_m=ANTENNA_M
        ),
        "echo": simulate_echo(config, SEED, FRAME, scene, folder / "echo.nmea", lever_ics_echo_m=ECHO_M),
        "tls": simulate_tls(
            config, SEED, FRAME, scene, [folder / f"tls_{i}.laz" for i in (1, 2, 3)], crs="EPSG:25833"
        ),
    }
    return Twin(config, folder, mesh, Voyage(config, SEED), facts)


@pytest.fixture(scope="session")
def scene(twin):
    return twin.scene


@pytest.fixture(scope="session")
def mount():
    """Rotation and lever arm of the scanner."""
    return R_ICS_SCS, LIDAR_M


@pytest.fixture
def record(twin, tmp_path):
    """Record the lidar again with other settings, on the same scene."""

    def again(name: str, **changes: Any) -> tuple[Path, dict[str, Any], TwinConfig]:
        config = short(**changes)
        path = tmp_path / f"{name}.pcap"
        return path, record_lidar(twin.scene, path, config), config

    return again


def true_depth_m(motion: Motion, scene: Scene, t_gps_s: ArrayF, lever_ics_echo_m: ArrayF) -> ArrayF:
    """Distance (n,) from the transducer to the bed along the boat's own down axis."""
    origin = motion.sensor_wcs_m(t_gps_s, lever_ics_echo_m)
    return scene.only(Material.BED).caster().cast(origin, motion.R_wcs_ics(t_gps_s)[:, :, 2]).t_hit_m
