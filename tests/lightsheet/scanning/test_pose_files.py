"""Files of sensor poses: what goes in comes out, and foreign files are named."""

import numpy as np
import pytest

from thalweg.core import InputError
from thalweg.lightsheet.poses import SensorPoses, pose_table, read_poses, write_poses


def poses(rng):
    """Three poses, the middle one missing."""
    A = rng.standard_normal((3, 6, 6)) * 1e-4
    found = SensorPoses(
        images=("a.png", "b ü.png", "c.png"),
        R_target_lcs=np.tile(np.eye(3), (3, 1, 1)),
        shift_m=rng.standard_normal((3, 3)),
        cov=A @ np.swapaxes(A, 1, 2),
        shared=1e-4 * rng.standard_normal((3, 6, 2)),
        reasons=("", "no picture", ""),
        t_gps_s=np.array([3e8, np.nan, 3e8 + 0.2]),
        target="standing camera",
        source="6-DOF",
        facts={"poses": 2.0, "scale_of_marks": 1.25},
    )
    for array in (found.R_target_lcs, found.shift_m, found.cov, found.shared):
        array[1] = np.nan
    return found


def test_poses_come_back_to_the_bit(tmp_path, rng):
    given, path = poses(rng), tmp_path / "poses.npz"
    write_poses(path, given)
    found = read_poses(path)
    for name in ("images", "reasons", "target", "source", "facts"):
        assert getattr(found, name) == getattr(given, name), name
    for name in ("R_target_lcs", "shift_m", "cov", "shared", "t_gps_s"):
        np.testing.assert_array_equal(getattr(found, name), getattr(given, name), err_msg=name)
    assert found.usable.tolist() == [True, False, True]
    again = tmp_path / "again.npz"
    write_poses(again, found)
    assert again.read_bytes() == path.read_bytes()


def test_poses_without_shared_errors_and_without_images_come_back(tmp_path, rng):
    for keep in (np.array([True, False, True]), np.zeros(3, dtype=bool)):
        given = poses(rng).where(keep)
        bare = given.__class__(
            **{f: getattr(given, f) for f in given.__slots__} | {"shared": given.shared[:, :, :0]}
        )
        write_poses(tmp_path / "p.npz", bare)
        found = read_poses(tmp_path / "p.npz")
        assert len(found) == keep.sum()
        assert found.shared.shape == (keep.sum(), 6, 0)


def test_foreign_files_are_named(tmp_path, rng):
    path = tmp_path / "poses.npz"
    write_poses(path, poses(rng))
    whole = path.read_bytes()
    other, array, empty, text, cut, parts = (tmp_path / f"{n}.npz" for n in "oaetcp")
    np.savez(other, mark=np.array("something else"))
    with array.open("wb") as stream:
        np.save(stream, np.zeros(3))
    empty.touch()
    text.write_text("pose 1")
    cut.write_bytes(whole[: len(whole) // 2])
    with np.load(path) as data:
        np.savez(parts, **{name: data[name] for name in data.files if name != "cov"})
    for wrong, words in (
        (other, "of the kind 'something else'"),
        (array, "an array"),
        (empty, "cannot be read"),
        (text, "cannot be read"),
        (cut, "cannot be read"),
        (parts, "cannot be read.*cov"),
        (tmp_path / "none.npz", "file not found"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            read_poses(wrong)
        assert caught.value.where == str(wrong)
        assert "poses of the light-sheet sensor" in caught.value.expected


def test_the_table_for_people_has_millimetres_and_degrees(rng):
    given = poses(rng)
    table = pose_table(given)
    assert table["file"].tolist() == list(given.images)
    assert table["reason"].tolist() == ["", "no picture", ""]
    own, shared = given.cov[0], given.shared[0] @ given.shared[0].T
    assert table["sigma_y_mm"][0] == pytest.approx(1e3 * np.sqrt(own[1, 1]))
    assert table["sigma_turn_z_deg"][0] == pytest.approx(np.rad2deg(np.sqrt(own[5, 5])))
    assert table["sigma_shared_x_mm"][0] == pytest.approx(1e3 * np.sqrt(shared[0, 0]))
    assert np.isnan(table["x_m"][1])
    # own and shared errors are what a pose has in all
    total = np.sqrt(np.diag(given.pose(2).cov))
    assert np.hypot(table["sigma_z_mm"][2], table["sigma_shared_z_mm"][2]) == pytest.approx(1e3 * total[2])
