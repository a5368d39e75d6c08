"""Frames of a video with their times, from files that OpenCV wrote with a time of making set by hand."""

import datetime as dt
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from thalweg.cli import main
from thalweg.core import InputError
from thalweg.ingest.photos import container_time, read_image_stamps, write_frames

MADE = dt.datetime(2026, 5, 12, 9, 30, 7, tzinfo=dt.UTC)


def video(path: Path, *, n: int = 25, rate_hz: float = 10.0, made: dt.datetime | None = MADE) -> Path:
    """Frames whose grey says their number, 8 a frame."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate_hz, (96, 64))
    assert writer.isOpened()
    for k in range(n):
        writer.write(np.full((64, 96, 3), 8 * k, np.uint8))
    writer.release()
    data = bytearray(path.read_bytes())
    at = data.index(b"mvhd") + 4
    assert data[at] == 0  # version with times of 32 bits
    since_1904 = 0 if made is None else int((made - dt.datetime(1904, 1, 1, tzinfo=dt.UTC)).total_seconds())
    struct.pack_into(">I", data, at + 4, since_1904)
    path.write_bytes(bytes(data))
    return path


def test_frames_get_the_time_of_the_container(tmp_path):
    source = video(tmp_path / "run.mp4")
    assert container_time(source) == MADE
    found = write_frames(source, tmp_path / "frames", every_s=0.5)
    assert found.table["file"].tolist() == [f"run_{k:06d}.jpg" for k in (0, 5, 10, 15, 20)]
    # whole seconds are cut: half a second later on the mean
    assert found.table["time_utc"].tolist()[:2] == [
        "2026-05-12T09:30:07.500000Z",
        "2026-05-12T09:30:08.000000Z",
    ]
    assert found.sigma_offset_s == pytest.approx(0.2887, abs=1e-4)
    assert found.jitter_s < 1e-3
    for row in found.table.itertuples():
        number = int(row.file[4:10])
        grey = cv2.imread(str(tmp_path / "frames" / row.file)).mean()
        assert grey == pytest.approx(8 * number, abs=3)  # JPEG and MPEG-4 of one grey
        assert row.since_begin_s == pytest.approx(number / 10.0, abs=1e-3)
    stamps = read_image_stamps(tmp_path / "frames", times=tmp_path / "frames/times.csv")
    np.testing.assert_allclose(np.diff(stamps.table["t_device_s"]), 0.5, atol=1e-5)
    assert set(stamps.table["source"]) == {"table"}


def test_a_stated_begin_wins(tmp_path, capsys):
    source = video(tmp_path / "run.mp4", made=None, n=12)
    with pytest.raises(InputError, match="does not say when it was made"):
        write_frames(source, tmp_path / "frames")
    with pytest.raises(InputError, match="without zone or standard deviation"):
        write_frames(source, tmp_path / "frames", begin=dt.datetime(2026, 5, 12, 9))
    words = ["frames", str(source), "--begin", "2026-05-12T11:30:00.25+02:00", "--sigma-begin", "0.05"]
    assert main([*words, "--out", str(tmp_path / "frames")]) == 0
    told = capsys.readouterr().out
    assert "12 frames, 1.100 s" in told
    assert "sigma_offset_s: 0.05" in told
    first = (tmp_path / "frames/times.csv").read_text().splitlines()[1]
    assert first.startswith("run_000000.jpg,2026-05-12T09:30:00.250000Z,0.0")


def test_what_is_no_video_is_refused(tmp_path):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"\0\0\0\x18ftypisom" + bytes(40))
    with pytest.raises(InputError, match="no MP4 or MOV container"):
        container_time(path)
    with pytest.raises(InputError, match="no video that OpenCV can decode"):
        write_frames(path, tmp_path / "f", begin=MADE, sigma_begin_s=1.0)
