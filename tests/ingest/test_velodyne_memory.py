"""The VLP-16 reader streams: its memory is that of its pieces, whatever the length of the recording."""

import gc
import tracemalloc

import pytest

from tests.ingest import test_velodyne_log as log
from thalweg.ingest.velodyne.reader import iter_points, scan_lidar

N = 250
CHUNK_BYTES = 1 << 16
HOUR = 1_700_000_000 // 3600 * 3600


def scan(path):
    return scan_lidar([path], chunk_bytes=CHUNK_BYTES).n_points


def read(path):
    return sum(b.n for b in iter_points([path], max_points=2000, chunk_bytes=CHUNK_BYTES))


def read_and_keep(path):
    return sum(b.n for b in list(iter_points([path], max_points=2000, chunk_bytes=CHUNK_BYTES)))


def peak_bytes(read_file, path):
    gc.collect()
    tracemalloc.start()
    try:
        n_points = read_file(path)
        return tracemalloc.get_traced_memory()[1], n_points
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """A recording of N packets and one of 4 N: 0.3 and 1.2 MB."""
    paths = []
    for n in (N, 4 * N):
        paths.append(tmp_path_factory.mktemp("memory") / f"{n}.pcap")
        paths[-1].write_bytes(log.pcap(log.recording(log.times(n, 5e6), hour_unix=HOUR, every=100)))
    return paths


@pytest.mark.parametrize("read_file", [scan, read])
def test_memory_does_not_grow_with_the_recording(recordings, read_file):
    short, long = recordings
    read_file(short)  # compiles, fills caches
    (few, n_few), (many, n_many) = peak_bytes(read_file, short), peak_bytes(read_file, long)
    assert n_many == pytest.approx(4 * n_few, rel=0.01)
    # The recordings differ by 0.9 MB, their points by more; one line a piece is kept for the host's clock.
    assert abs(many - few) < 200_000
    # the memory for duplicates is 16 MB whatever is read
    assert many < 16 * 2**20 + 60 * CHUNK_BYTES


def test_the_measure_sees_what_is_kept(recordings):
    few, many = (peak_bytes(read_and_keep, path)[0] for path in recordings)
    assert many - few > 1_650_000
