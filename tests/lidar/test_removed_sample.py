"""The sample of removed points: bounded, even, and blind to the pieces of the log."""

import numpy as np
import pyarrow as pa

from thalweg.core import read_table, write_table
from thalweg.core.tables import kind_of
from thalweg.lidar import REMOVED, REMOVED_POINTS, Reason
from thalweg.lidar.cloud import RemovedSample


def sampled(reasons, most, pieces):
    """A sample of points that carry their number as time."""
    return sampled_rows(reasons, np.arange(len(reasons)), most, pieces)


def sampled_rows(reasons, rows, most, pieces=1):
    """The same of some of the points."""
    number = np.arange(len(reasons), dtype=np.float64)
    sample = RemovedSample(most)
    for part in np.array_split(rows, pieces):
        sample.add(
            reasons[part],
            t_gps_s=number[part],
            points_wcs_m=number[part][:, None] + np.array([0.0, 0.25, 0.5]),
            x_ics_m=np.column_stack([number[part]] * 3).astype(np.float32),
            range_m=number[part].astype(np.float32),
        )
    return sample


def test_the_sample_is_bounded_even_and_blind_to_pieces(rng):
    n, most = 400_000, 2000
    reasons = rng.choice(np.array([0, Reason.TOO_NEAR, Reason.ISOLATED], np.uint8), n, p=[0.5, 0.499, 0.001])
    table = sampled(reasons, most, 1).table()
    assert table.equals(sampled(reasons, most, 41).table())
    joined = RemovedSample(most)
    for rows in np.array_split(np.arange(n), 7):
        part = sampled_rows(reasons, rows, most)
        assert sum(len(values) for values in part.arrays().values()) < 2 * len(REMOVED) * most
        joined.add_arrays(part.arrays())
    assert table.equals(joined.table())
    sizes = table["reason"].value_counts()
    # few enough: all of them; too many: between half and all of the bound, the half itself being binomial
    assert sizes["isolated"] == np.sum(reasons == Reason.ISOLATED)
    assert 0.9 * most / 2 < sizes["too_near"] <= most
    near = table[table["reason"] == "too_near"]
    t = near["t_gps_s"].to_numpy()
    assert (reasons[t.astype(int)] == Reason.TOO_NEAR).all()
    assert (np.diff(t) > 0).all()
    assert (near["north_m"] == t + 0.25).all()
    # 20 stretches of the log, 16 lasers: chi-square with 19 and 15 degrees of freedom, P = 1e-4 above 50, 44
    for bins, limit in ((np.histogram(t, 20, (0, n))[0], 50.0), (np.bincount(t.astype(int) % 16), 44.0)):
        expected = len(t) / len(bins)
        assert np.sum((bins - expected) ** 2 / expected) < limit


def test_the_sample_is_a_documented_table(tmp_path):
    reasons = np.array([0, 1, 9, 1], np.uint8)
    table = sampled(reasons, 10, 2).table()
    write_table(tmp_path / "removed.parquet", table, REMOVED_POINTS, {"decoded": 4})
    back, meta = read_table(tmp_path / "removed.parquet", REMOVED_POINTS)
    assert kind_of(REMOVED_POINTS) == ("removed_points", 1)
    assert meta == {"decoded": 4}
    assert back["reason"].tolist() == ["no_gps_time", "no_gps_time", "isolated"]
    assert back["t_gps_s"].tolist() == [1.0, 3.0, 2.0]
    assert REMOVED_POINTS.field("range_m").type == pa.float32()
    empty = sampled(np.zeros(3, np.uint8), 10, 1).table()
    write_table(tmp_path / "nothing.parquet", empty, REMOVED_POINTS)
    assert len(read_table(tmp_path / "nothing.parquet", REMOVED_POINTS)[0]) == 0
    assert len(REMOVED) == len(Reason) - 1
