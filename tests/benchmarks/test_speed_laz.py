"""Speed of the LAZ writer beside plain laspy: the same columns, chunks and compression."""

from pathlib import Path

import laspy
import numpy as np
import pytest

from tests.benchmarks import turns
from thalweg.core import LazWriter, LocalFrame, iter_laz
from thalweg.lidar import SIGMAS
from thalweg.lidar.cloud import EXTRA_DIMENSIONS

CHUNK = 1_000_000
FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)


def cloud_columns(n: int) -> dict[str, np.ndarray]:
    """A swath in the order of the shots: 16 beams that sweep a bank, sigmas that grow with the range."""
    rng = np.random.default_rng(3)
    shot = np.arange(n)
    ring = (shot % 16).astype(np.uint8)
    elevation = np.radians(ring * 2.0 - 15)
    turn = np.radians(-10 + 20 * (shot // 16 % 100) / 100)
    range_m = ((25 + 3 * np.sin(9 * turn)) / np.cos(elevation) + rng.normal(0, 0.017, n)).astype(np.float32)
    t_s = shot / 28e3
    columns = {
        "x": 0.5 * t_s + range_m * np.sin(elevation),
        "y": range_m * np.cos(elevation) * np.cos(turn),
        "z": range_m * np.cos(elevation) * np.sin(turn),
        "t_gps_s": 3.0e8 + t_s,
        "intensity": rng.integers(20, 60, n).astype(np.uint8),
        "range": range_m,
        "ring": ring,
    }
    for k, name in enumerate(SIGMAS):
        columns[name] = np.hypot(0.03, (1 + k) * 1e-3 * range_m).astype(np.float32)
    return columns


def with_thalweg(path: Path, columns: dict[str, np.ndarray]) -> None:
    with LazWriter(path, FRAME, extra_dimensions=EXTRA_DIMENSIONS, offset_m=np.zeros(3)) as writer:
        for start in range(0, len(columns["x"]), CHUNK):
            c = {name: values[start : start + CHUNK] for name, values in columns.items()}
            one = np.ones(len(c["x"]), np.uint8)
            writer.append(
                np.stack([c["x"], c["y"], c["z"]], axis=1),
                t_gps_s=c["t_gps_s"],
                intensity=c["intensity"],
                return_number=one,
                number_of_returns=one,
                extra={name: c[name] for name in EXTRA_DIMENSIONS},
            )


def with_laspy(path: Path, columns: dict[str, np.ndarray]) -> None:
    """As its documentation does it; the default backend is that of `LazWriter` too."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.zeros(3)
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(
                name,
                np.dtype(spec[0]),
                spec[1],
                scales=np.array([spec[2]]) if len(spec) == 3 else None,
                offsets=np.zeros(1) if len(spec) == 3 else None,
            )
            for name, spec in EXTRA_DIMENSIONS.items()
        ]
    )
    with laspy.open(path, mode="w", header=header) as writer:
        for start in range(0, len(columns["x"]), CHUNK):
            c = {name: values[start : start + CHUNK] for name, values in columns.items()}
            points = laspy.ScaleAwarePointRecord.zeros(len(c["x"]), header=writer.header)
            points.x, points.y, points.z = c["x"], c["y"], c["z"]
            points.gps_time = c["t_gps_s"]
            points.intensity = c["intensity"].astype(np.uint16) * 256
            points["return_number"][:] = 1
            points["number_of_returns"][:] = 1
            for name in EXTRA_DIMENSIONS:
                points[name] = c[name]
            writer.write_points(points)


def read_with_thalweg(path: Path) -> int:
    return sum(len(chunk["xyz_m"]) for chunk in iter_laz(path, CHUNK))


def read_with_laspy(path: Path, names: tuple[str, ...]) -> int:
    """The same columns as arrays."""
    n = 0
    with laspy.open(path) as reader:
        for points in reader.chunk_iterator(CHUNK):
            columns = [np.array(points[name]) for name in ("x", "y", "z", *names)]
            n += len(columns[0])
    return n


@pytest.mark.slow
def test_laz_beside_plain_laspy(tmp_path, capsys):
    n = turns.sized(10e6)
    columns = cloud_columns(n)
    own, plain = tmp_path / "own.laz", tmp_path / "plain.laz"
    few = {name: values[:1000] for name, values in columns.items()}
    with_thalweg(own, few), with_laspy(plain, few)
    took = turns.in_turns(
        {"own": lambda: with_thalweg(own, columns), "plain": lambda: with_laspy(plain, columns)}
    )
    names = (*next(iter_laz(own, 10)),)[1:]
    took |= turns.in_turns(
        {
            "read own": lambda: read_with_thalweg(own),
            "read plain": lambda: read_with_laspy(
                plain, tuple({"t_gps_s": "gps_time"}.get(k, k) for k in names)
            ),
        }
    )
    bytes_own, bytes_plain = own.stat().st_size, plain.stat().st_size
    with capsys.disabled():
        print(
            f"\nLAZ of {n:,} points with three sigmas: written by thalweg {turns.millions(n, took['own'])}, "
            f"by plain laspy {turns.millions(n, took['plain'])}: ratio {took['plain'] / took['own']:.2f}; "
            f"read {turns.millions(n, took['read own'])} and {turns.millions(n, took['read plain'])}: "
            f"ratio {took['read plain'] / took['read own']:.2f}; {bytes_own / n:.1f} B/point"
        )
    # header, frame and the first chunk's offset apart, both hold the same points
    assert abs(bytes_own - bytes_plain) < 0.001 * bytes_plain + 4096
    done = 0
    with laspy.open(plain) as reader:
        for chunk, theirs in zip(iter_laz(own, CHUNK), reader.chunk_iterator(CHUNK), strict=True):
            for axis, name in enumerate("xyz"):
                np.testing.assert_allclose(chunk["xyz_m"][:, axis], theirs[name], rtol=0, atol=1.01e-3)
            np.testing.assert_array_equal(chunk["t_gps_s"], theirs["gps_time"])
            np.testing.assert_array_equal(chunk["intensity"], theirs["intensity"])
            for name in EXTRA_DIMENSIONS:  # laspy cuts what Thalweg rounds: one step of 0.1 mm
                np.testing.assert_allclose(chunk[name], theirs[name], rtol=0, atol=1.01e-4)
            done += len(chunk["xyz_m"])
    assert done == n
    assert took["own"] < 1.5 * took["plain"]  # generous: the disk and its neighbours have a say
