"""References that are not what they should be: what is refused, what is told, and in which words."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thalweg.core import CoverageError, LazWriter, LocalFrame
from thalweg.settings.sections import ReferenceSettings
from thalweg.surface import Area, compare_files, mesh_reference, read_reference
from thalweg.surface.meshing import _console_to_log, fit_bank
from thalweg.surface.reference import ReferencePoints

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
TRACK = np.column_stack([np.linspace(-40, 40, 200), np.full(200, 15.0), np.zeros(200)])
AREA = Area(polygon_en_m=np.array([[-5.0, -4], [5, -4], [5, 4], [-5, 4]]), lowest_m=-0.5, highest_m=3.5)
NAMES = ("one.laz", "two.laz", "three.laz")


def bank(seed: int = 1, n: int = 20_000) -> np.ndarray:
    """A bank of 12 m by 8 m that rises to the south from 0 to 4 m, rough by 5 mm."""
    rng = np.random.default_rng(seed)
    p = rng.uniform([-6, -4, 0], [6, 4, 0], (n, 3))
    p[:, 2] = (4 - p[:, 1]) / 2 + rng.normal(0, 0.005, n)
    return p


def read(folder: Path, *clouds: np.ndarray, area: Area = AREA) -> ReferencePoints:
    with LazWriter(folder / "reference.laz", FRAME) as writer:
        for number, xyz in enumerate(clouds, start=1):
            writer.append(xyz, point_source_id=np.full(len(xyz), number, dtype=np.uint16))
    return read_reference(folder / "reference.laz", FRAME, area, margin_m=2.0, files=NAMES)


def told(points: np.ndarray, track: np.ndarray = TRACK, **settings: Any) -> tuple[list[str], dict[str, Any]]:
    _, facts = mesh_reference(points, track_m=track, settings=ReferenceSettings(**settings))
    return facts["notes"], facts


# ---------------------------------------------------------------- files and the area


def test_a_file_beside_the_area_is_named(tmp_path):
    found = read(tmp_path, bank(), np.add(bank(2), [150, 0, 0]))
    assert len(found.notes) == 1
    # 150 m, less both halves: 6 m of the bank and 5 m of the area
    assert found.notes[0].startswith(
        "two.laz: none of 20,000 points lies in the area of interest: in plan they"
    )
    assert "end 139 m from it" in found.notes[0]
    assert found.files[2] == {"file": "two.laz", "points": 20_000, "near_area": 0}
    assert found.files[1]["near_area"] == len(found.points_m) > 19_000
    assert (found.source == 1).all()
    assert read(tmp_path, bank(), bank(2)).notes == []


@pytest.mark.parametrize(("shift_m", "words"), [(42.3, "42.8 m above"), (-42.3, "41.8 m below")])
def test_a_file_of_another_height_system_is_refused(tmp_path, shift_m, words):
    """The bank's mean height is 2.0 m, the middle of the area's heights 1.5 m."""
    with pytest.raises(CoverageError, match=f"^two.laz: none of .*on average {words}.*geoid") as error:
        read(tmp_path, bank(), np.add(bank(2), [0, 0, shift_m]))
    assert "campaign.origin.h_ell_m" in str(error.value)
    with pytest.raises(CoverageError, match=f"^one.laz: .*{words}"):
        read(tmp_path, np.add(bank(), [0, 0, shift_m]))


def test_nine_metres_are_no_geoid(tmp_path):
    with pytest.raises(CoverageError, match=r"9\.5 m above.*min_height_m and max_height_m") as error:
        read(tmp_path, np.add(bank(), [0, 0, 9.0]))
    assert "geoid" not in str(error.value)
    # one of two files is told only: it may have seen a crown and nothing else
    assert "9.5 m above" in read(tmp_path, bank(), np.add(bank(2), [0, 0, 9.0])).notes[0]


def test_with_one_limit_the_gap_is_that_to_the_limit(tmp_path):
    with pytest.raises(CoverageError, match=r"on average 38\.0 m below its limit.*geoid"):
        read(tmp_path, bank(), area=Area(lowest_m=40.0))


def test_kilometres_away_the_grid_is_asked_for(tmp_path):
    with pytest.raises(CoverageError, match=r"end 2,989 m from it.*Another CRS or zone"):
        read(tmp_path, np.add(bank(), [3000, 0, 0]))
    with pytest.raises(CoverageError, match=r"end 989 m from it.*order east, north"):
        read(tmp_path, np.add(bank(), [1000, 0, 0]))


def test_two_points_in_the_area_are_told_with_those_outside(tmp_path):
    with pytest.raises(CoverageError, match="only 2 of 3 reference points lie in the area of interest"):
        read(tmp_path, np.array([[0.0, 0, 2], [1, 0, 2], [90, 0, 2]]))


def test_many_files_without_any_point_inside(tmp_path):
    with pytest.raises(CoverageError, match=r"reference\.laz: none of 40,000"):
        read(tmp_path, np.add(bank(), [300, 0, 0]), np.add(bank(2), [150, 0, 0]))


# ---------------------------------------------------------------- files against each other


def compared(folder: Path, *clouds: np.ndarray) -> tuple[list[dict[str, Any]], list[str]]:
    found = read(folder, *clouds, area=Area())
    return compare_files(found, fit_bank(found.points_m, TRACK).frame)


def test_two_registrations_are_told_apart(tmp_path):
    # 1 m up on a slope of 1 in 2 is 1 / sqrt(1.25) m along the normal
    pairs, notes = compared(tmp_path, bank(), np.add(bank(2), [0, 0, 1.0]), bank(3))
    assert [note[:42] for note in notes] == [
        "two.laz lies 0.89 m in front of one.laz wh",
        "three.laz lies 0.89 m behind two.laz where",
    ]
    assert "another epoch, registration" in notes[0]
    # a cell holds 50 points and is inclined by a degree at most: 2 mm, the median of 300 cells is better
    np.testing.assert_allclose([p["apart_m"] for p in pairs], [0.894, 0, -0.894], atol=0.003)
    assert min(p["cells"] for p in pairs) > 250


def test_ten_centimetres_are_told_and_two_are_not(tmp_path):
    assert len(compared(tmp_path, bank(), np.add(bank(2), [0, 0, 0.1]))[1]) == 1
    assert compared(tmp_path, bank(), np.add(bank(2), [0, 0, 0.02]))[1] == []


def test_where_files_do_not_meet_nothing_is_compared(tmp_path):
    assert compared(tmp_path, bank(), np.add(bank(2), [20.0, 0, 0])) == ([], [])
    # 2 m of 12 m are common
    assert len(compared(tmp_path, bank(), np.add(bank(2), [10.0, 0, 0.5]))[1]) == 1


def test_crowns_seen_from_two_sides_are_no_registration(tmp_path):
    """All that both files share are leaves, anywhere within 6 m, those of the second 0.5 m lower."""
    rng = np.random.default_rng(4)
    leaves = [rng.uniform([-6, -4, 5], [6, 4, 11], (3000, 3)) for _ in range(2)]
    frame = fit_bank(bank(), TRACK).frame
    pairs, notes = compare_files(read(tmp_path, leaves[0], leaves[1] - [0, 0, 0.5], area=Area()), frame)
    assert pairs[0]["cells"] > 100
    assert abs(pairs[0]["apart_m"]) > 0.2
    assert pairs[0]["spread_m"] > abs(pairs[0]["apart_m"])
    assert notes == []


# ---------------------------------------------------------------- notes on the mesh


def test_two_epochs_in_one_cloud_are_noted():
    p = np.concatenate([bank(), np.add(bank(2), [0, 0, 1.0])])
    notes, facts = told(p)
    assert facts["counts"]["in_front"] > 0.45 * len(p)
    assert any("%) were left out in front" in n and "0.9 m: dense plants, or a second" in n for n in notes)
    assert told(bank())[0] == []


def test_two_sheets_of_a_poisson_surface_are_noted():
    p = np.concatenate([bank(), np.add(bank(2), [0, 0, 1.5])])
    notes, facts = told(p, method="poisson", clearance_m=None, cell_m=0.2)
    assert 1.6 < facts["layers"] < 2.1
    assert any("covers its ground" in note and "second surface" in note for note in notes)
    plain, facts = told(bank(), method="poisson", clearance_m=None, cell_m=0.2)
    assert facts["layers"] < 1.2
    assert plain == []


def test_a_long_edge_does_not_take_the_mesh_for_a_fragment():
    notes, facts = told(bank(n=4000), cell_m=1.0, longest_edge_m=50.0)
    # 12 m by 8 m: cells of 1 m have their points half a cell inside
    assert facts["area_m2"] > 60
    assert facts["counts"]["fragment_faces"] == 0
    assert notes == []


def test_small_pieces_still_go():
    island = np.random.default_rng(3).uniform([8.0, 0, 2], [8.3, 0.3, 2.001], (200, 3))
    _, facts = told(np.concatenate([bank(), island]))
    assert facts["counts"]["fragment_faces"] > 0
    assert facts["pieces"] == 1


def test_edges_shorter_than_the_spacing_are_noted():
    """Points 7 cm apart, edges up to 8 cm: half of the points find no triangle."""
    notes, facts = told(bank(), cell_m=0.005, longest_edge_m=0.05)
    assert facts["counts"]["unused_vertices"] > 0.5 * facts["counts"]["kept"]
    assert any("raise reference.longest_edge_m (0.05 m)" in note for note in notes)


def test_a_boat_elsewhere_is_noted():
    notes, facts = told(bank(), np.add(TRACK, [0, 5_000_000, 0]))
    assert facts["track_m"] == pytest.approx(5e6, rel=1e-4)
    assert any("The boat stays 5,000.0 km or more away" in note for note in notes)


# ---------------------------------------------------------------- Poisson's library


def test_what_the_library_prints_goes_to_the_log(capfd, caplog):
    import os

    caplog.set_level("INFO", logger="thalweg")
    with _console_to_log():
        for _ in range(3):
            os.write(2, b"[WARNING] bad average roots\n")
        os.write(1, b"another\n")
    os.write(1, b"afterwards\n")
    assert capfd.readouterr() == ("afterwards\n", "")
    assert [record.message for record in caplog.records] == [
        "Poisson reconstruction: [WARNING] bad average roots (3 times)",
        "Poisson reconstruction: another",
    ]
