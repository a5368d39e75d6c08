"""What a campaign of epochs may say wrong, and what it brings along."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from pyproj import CRS

from tests.las_files import write_laz
from thalweg.cli import main
from thalweg.core import ConfigError
from thalweg.settings import load_campaigns, with_calibrations
from thalweg.workflow import CampaignFiles

PLACE = "crs: EPSG:25833, origin: {lat_deg: 51.05, lon_deg: 13.25, h_ell_m: 300.0}"
MOUNTS = "lidar: {phi_deg: -90.0, lever_ics_m: [0, 0, 0]}, antenna: {lever_ics_m: [0.1, 0.0, -0.4]}"
CAMERA = "camera: {omega_deg: -90.0, kappa_deg: 180.0, lever_ics_m: [-0.25, 0.1, -0.2]}"


def write(folder: Path, name: str, sections: str) -> None:
    more = yaml.safe_load(sections)
    identity = yaml.safe_load(f"{{id: {name}, title: {name}, {PLACE}}}") | more.pop("campaign", {})
    (folder / f"{name}.yaml").write_text(yaml.safe_dump({"campaign": identity, **more}))


def joined(folder: Path) -> CampaignFiles:
    """The campaign of epochs with those that it brings along."""
    campaigns = with_calibrations(load_campaigns("change", folder), folder)
    return CampaignFiles(name="change", campaigns=campaigns)


@pytest.fixture
def folder(tmp_path):
    for month, name in (("04", "spring"), ("09", "autumn"), ("12", "winter")):
        twin = f"size: tiny, time_lapse: null, start_utc: '2021-{month}-12T08:59:48Z'"
        write(tmp_path, name, f"{{twin: {{{twin}}}, mounts: {{{MOUNTS}}}}}")
    write(tmp_path, "change", "epochs: [{campaign: spring}, {campaign: autumn}]")
    return tmp_path


def told(folder: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load_campaigns("change", folder)
    return str(caught.value)


def test_epochs_join_the_campaigns_and_bring_their_results(folder):
    files = joined(folder)
    assert list(files.campaigns) == ["spring", "autumn", "change"]
    assert files.epoch_pairs() == ["1-2"]
    assert files.epoch_points("autumn") == "results/autumn/lidar/points.laz"
    assert files.epochs_of("1-2", "points.npz")[1] == "results/change/deformation/epochs/autumn/points.npz"
    assert files.is_twin()
    # points of epochs need their full covariance
    assert files.of("spring").is_epoch()
    assert files.of("spring").georeferencing()["correlations"]


def test_three_epochs_are_compared_one_after_the_other_and_first_with_last(folder):
    write(folder, "change", "epochs: [{campaign: spring}, {campaign: autumn}, {campaign: winter}]")
    assert joined(folder).epoch_pairs() == ["1-2", "2-3", "1-3"]


def test_how_errors_last_comes_from_the_chain_of_each_epoch(folder):
    write(folder, "photos", f"{{twin: {{size: tiny, time_lapse: {{}}}}, mounts: {{{MOUNTS}, {CAMERA}}}}}")
    write(folder, "change", "epochs: [{campaign: spring}, {campaign: photos, chain: fused}]")
    files = joined(folder)
    assert files.epoch_errors("spring") == "results/spring/orientation/error_model.json"
    assert files.epoch_errors("photos") == "results/photos/orientation/errors_fused.npz"


def test_an_epoch_by_strips_has_the_errors_of_poses_and_mount_together(folder):
    twin = "twin: {size: tiny, time_lapse: null}"
    write(folder, "banked", f"{{{twin}, mounts: {{{MOUNTS}}}, strips: {{adjust: true}}}}")
    write(folder, "change", "epochs: [{campaign: spring}, {campaign: banked, chain: strips}]")
    files = joined(folder)
    assert files.epoch_points("banked") == "results/banked/lidar/by_strips/points.laz"
    at = "results/banked/orientation"
    assert files.epoch_trajectory("banked") == f"{at}/trajectory_strips_lidar.parquet"
    assert files.epoch_errors("banked") == f"{at}/errors_strips_lidar.npz"
    assert files.epoch_mounts("banked") == f"{at}/mounts_strips.json"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("epochs: [{campaign: spring}]", "at least 2"),
        ("epochs: [{campaign: spring}, {campaign: autumn, chain: strips}]", "adjusts no strips"),
        ("epochs: [{campaign: spring}, {campaign: spring}]", "'spring' a second time"),
        ("epochs: [{campaign: spring}, {campaign: change}]", "'change' is this campaign itself"),
        ("epochs: [{campaign: spring}, {campaign: autunm}]", "Did you mean autumn?"),
        ("epochs: [{campaign: spring}, {campaign: autumn, chain: camera}]", "has no time-lapse images"),
        (
            """
            campaign: {crs: EPSG:25832, origin: {lat_deg: 51.05, lon_deg: 9.0, h_ell_m: 0.0}}
            epochs: [{campaign: spring}, {campaign: autumn}]
            """,
            "is in EPSG:25833, this campaign in EPSG:25832",
        ),
        (
            "{epochs: [{campaign: spring}, {campaign: autumn}], twin: {size: tiny}}",
            "both twin and epochs are given",
        ),
        (
            "{epochs: [{campaign: spring}, {campaign: autumn}], deformation: {reach_m: 0.2}}",
            "the cylinders would be discs",
        ),
        (
            "epochs: [{campaign: autumn}, {campaign: spring}]",
            "epochs[1].campaign: 2021-04-12 08:59 UTC, before epoch 1; expected epochs in the order of time",
        ),
        (
            "epochs: [{campaign: spring}, {campaign: autumn, surface: bed}]",
            "surface 'bed' without correlation_m",
        ),
        ("epochs: [{campaign: spring}, {campaign: autumn, sigma_m: 0.1}]", "sigma_m beside campaign"),
        ("epochs: [{campaign: spring}, {chain: ins}]", "neither campaign nor clouds nor dsm"),
        ("epochs: [{campaign: spring}, {campaign: autumn, dsm: a.tif}]", "campaign and dsm"),
    ],
)
def test_mistakes_name_what_to_do(folder, change, words):
    write(folder, "change", change)
    assert words in told(folder)


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ("[{date_utc: null}]", "epochs[1]: files without a date; expected date_utc: the day of the survey"),
        ("[{date_utc: 13.3.2021}]", "not a day such as 2021-05-12 or a UTC time"),
        ("[{}, {clouds: [b.xyz]}]", "the time of epoch 2 too"),
        ("[{date_utc: '2021-04-12T08:59:48Z'}]", "the time of epoch 1 too"),
        ("[{}, {clouds: [b.xyz], date_utc: '2021-04-20'}]", "before epoch 2; expected epochs in the ord"),
        ("[{clouds: [b.laz]}]", "b.laz: no such file"),
        ("[{clouds: [none/*.laz]}]", "the pattern matches no file"),
        ("[{clouds: [empty.laz]}]", "empty.laz: the file is empty"),
        ("[{clouds: [a.tif]}]", "files that end in .tif are not read here"),
        ("[{clouds: [], dsm: a.laz}]", "surface models stand under dsm, points under clouds"),
        ("[{}, {clouds: [a.laz], date_utc: '2021-06-01'}]", "already the surface of epoch 2"),
        ("[{sigma_m: 0.1}]", "sigma_m without correlation_m"),
        ("[{correlation_m: 10.0}]", "correlation_m without sigma_m"),
        ("[{sigma_m: -0.1, correlation_m: 10.0}]", "of at least 0"),
        ("[{crs: 'EPSG:99999'}]", "epochs[1].crs: 'EPSG:99999' is unknown to PROJ"),
        ("[{crs: 'EPSG:4326'}]", "epochs[1].crs: 'EPSG:4326' is not projected"),
        ("[{crs: 'EPSG:32631'}]", "outside the area of use of EPSG:32631"),
        ("[{crs: 'EPSG:25833+7837'}]", "has heights 'DHHN2016 height', epoch 1 (spring) 'ellipsoidal'"),
        ("[{name: autumn}]", "the name 'autumn' is that of a campaign"),
        ("[{chain: ins}]", "chain beside clouds"),
        ("[{leave_out: ['water.gpkg?day=1']}]", "water.gpkg: no such file"),
    ],
)
def test_mistakes_of_files_are_told_before_anything_runs(folder, files, words):
    for name, text in (("a.laz", "points"), ("b.xyz", "1 2 3"), ("a.tif", "heights"), ("empty.laz", "")):
        (folder / name).write_text(text)
    usual = {"clouds": ["a.laz"], "date_utc": "2021-05-12"}
    epochs = [{"campaign": "spring"}, *(usual | each for each in yaml.safe_load(files))]
    write(folder, "change", yaml.safe_dump({"epochs": epochs}))
    assert words in told(folder)


def test_files_join_the_epochs_under_names_of_their_own(folder):
    for name in ("a.laz", "b1.xyz", "b2.xyz", "c.tif"):
        (folder / name).write_text("points")
    write(
        folder,
        "change",
        """
        epochs:
          - {clouds: [a.laz], date_utc: '2020-05-12'}
          - {campaign: spring}
          - {clouds: [b*.xyz], date_utc: '2021-05-12', name: scanner}
          - {dsm: c.tif, date_utc: '2021-05-12T18:00:00Z'}
          - {campaign: autumn, surface: bed, correlation_m: 8.0}
        """,
    )
    files = joined(folder)
    assert files.epoch_names() == ["epoch_1", "spring", "scanner", "epoch_4", "autumn_bed"]
    assert files.epochs_with_trajectory(wanted=True) == ["spring"]
    assert files.epoch_surface("scanner") == [str(folder / "b1.xyz"), str(folder / "b2.xyz")]
    assert files.epoch_surface("autumn_bed") == ["results/autumn/bathymetry/bed.tif"]
    assert files.epoch_positions("autumn_bed") == ["results/autumn/ingest/positions.parquet"]
    assert files.epoch_statement("autumn_bed")["correlation_m"] == 8.0
    assert files.surface_statements("3-4") == []
    assert [each["dsm"] for each in files.surface_statements("4-5")] == [
        str(folder / "c.tif"),
        "results/autumn/bathymetry/bed.tif",
    ]
    assert files.change_truth() == []  # of files no truth is known
    assert files.is_twin()


def test_mistakes_of_an_epoch_are_told_with_its_file(folder):
    write(folder, "autumn", f"{{twin: {{size: huge}}, mounts: {{{MOUNTS}}}}}")
    text = told(folder)
    assert "the campaign 'autumn' has mistakes of its own" in text
    assert "autumn.yaml" in text


def test_a_new_campaign_of_epochs_is_a_good_one(folder, capsys):
    arguments = ["new-campaign", "flood", "--epochs", "spring", "autumn", "--folder", str(folder)]
    assert main(arguments) == 0
    text = (folder / "flood.yaml").read_text().replace("flood  # CHANGE", "flood # changed")
    (folder / "flood.yaml").write_text(text)
    assert load_campaigns("flood", folder)["flood"].is_change


def test_a_new_campaign_of_files_has_their_grid_and_place(folder, capsys):
    path = folder / "flood.yaml"

    def checked(text: str) -> tuple[int, str]:
        """What ``check-config`` returns and says of a campaign of this text."""
        path.write_text(text)
        code = main(["check-config", str(path)])
        return code, "".join(capsys.readouterr())

    xyz = np.random.default_rng(1).uniform(0.0, 20.0, (50, 3))
    xyz += np.array([377_000.0, 5_657_000.0, 295.0])
    for name in ("a.laz", "b.laz"):
        write_laz(folder / name, [{"xyz_m": xyz}], CRS.from_epsg(25833))
    new = ["new-campaign", "flood", "--folder", str(folder), "--epochs"]
    assert main([*new, f"{folder}/a.laz@2019-03-13", f"{folder}/b.laz"]) == 0
    text = path.read_text()
    assert "- clouds: [a.laz]\n    date_utc: 2019-03-13" in text
    assert "date_utc: CHANGE" in text
    capsys.readouterr()
    code, said = checked(text)
    assert (code, "not a day such as" in said) == (2, True)
    text = text.replace("CHANGE  # day", "2020-03-13  # day")
    # what a verdict needs is asked for, of each epoch, all at once
    code, asked = checked(text)
    assert code == 2
    for key in ("sigma_m", "correlation_m", "leave_out"):
        for i in (0, 1):
            assert f"epochs[{i}].{key}: not filled in yet" in asked
    assert "deformation.stable: not filled in yet; expected ground that did not move" in asked
    text = text.replace("leave_out: CHANGE", "leave_out: []").replace(": CHANGE", ": null")
    code, said = checked(text.replace("stable: null", "stable: roads.gpkg"))
    assert (code, "roads.gpkg" in said) == (2, True)
    code, said = checked(text)
    assert (code, "epochs epoch_1, epoch_2" in said) == (0, True)
    place = load_campaigns("flood", folder)["flood"].campaign
    assert place.crs == "EPSG:25833"
    assert (place.origin.lat_deg, place.origin.lon_deg) == pytest.approx((51.05, 13.25), abs=0.01)
    # what the headers say is refused by the same command
    write_laz(folder / "b.laz", [{"xyz_m": xyz}], CRS.from_epsg(25832))
    code, said = checked(text.replace("# crs: EPSG:25833+7837", "crs: EPSG:25833"))
    assert (code, "epochs[1]: " in said) == (2, True)
    assert "the file states ETRS89 / UTM zone 32N, the campaign file ETRS89 / UTM zone 33N" in said
