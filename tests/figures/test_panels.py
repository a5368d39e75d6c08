"""Every figure with nothing to show: no table, an empty one, one value, the same value, no number.

A figure function is one below ``@styled`` in a folder called ``figures``. Each has an example: the arguments
that a test of its own gives to it, which are caught while that test runs.
"""

import ast
import inspect
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from tests.figures.conftest import make_comparison
from tests.figures.panel_states import (
    CaughtError,
    NoSuchStateError,
    cases,
    catch,
    faults,
    faults_of_page,
    function_of,
    warned,
)
from thalweg.core import ThalwegError

EXAMPLES = {
    "bathymetry/test_soundings.py": {
        "figures.bathymetry.pictures:draw_sounding_lines": "test_each_line_is_drawn_with_what_it_lost"
    },
    "figures/test_bed_strip.py": {
        "lightsheet.figures.survey:bed_strip": "test_the_strip_beside_the_true_bed"
    },
    "figures/test_calibration_clocks.py": {
        "figures.calibration.clock:clock_offset": "test_the_offset_figure_shows_both_tracks",
        "figures.calibration.clock:clock_stability": "test_intervals_jump_over_what_could_not_be_read",
    },
    "figures/test_calibration_figures.py": {
        "figures.calibration.cones:cone_before_after": "test_before_and_after",
        "figures.calibration.field:field_positions": "test_positions_have_one_colour_each",
        "figures.calibration.field:field_reference": "test_the_calibration_in_four_pictures",
        "figures.calibration.field:field_setup": "test_the_field_shows_cones_and_sensors",
        "figures.calibration.quality:calibration_design": (
            "test_the_design_study_has_a_line_for_each_number_of_positions"
        ),
        "thalweg_lab.figures.synthetic_view:synthetic_view": "test_a_synthetic_view_colours_cones_by_height",
    },
    "figures/test_catalogue.py": {"figures.catalogue:control_chart": "test_items_are_those_of_stac"},
    "figures/test_change_figures.py": {
        "figures.deformation.heights:height_difference": (
            "test_difference_of_heights_is_drawn_with_its_sigma[False]"
        ),
        "figures.deformation.maps:change_map": "test_change_map_counts_bare_ground_and_states_the_ends",
        "figures.deformation.maps:significance_map": ("test_significance_map_names_states_with_their_area"),
        "figures.deformation.statistics:retreat_along": (
            "test_movement_of_both_lines_is_drawn_in_centimetres"
        ),
        "figures.deformation.statistics:stable_ground": (
            "test_stable_ground_is_held_against_the_standard_normal"
        ),
        "figures.deformation.statistics:volume_along": "test_volumes_along_the_bank",
        "figures.deformation.together:epochs_together": (
            "test_both_epochs_together_with_point_to_point_distances"
        ),
        "figures.deformation.views:epochs_from_above": "test_epochs_from_above",
        "figures.deformation.views:profiles": "test_profiles_show_both_epochs_registered",
    },
    "figures/test_cross_sections.py": {
        "figures.accuracy.cross_sections:cross_sections": "test_what_the_picture_says"
    },
    "figures/test_distance_map.py": {
        "figures.accuracy.distance_map:distance_map": "test_the_title_states_n_mean_and_rmse"
    },
    "figures/test_distance_statistics.py": {
        "figures.accuracy.distances:distance_by_range": "test_the_curves_are_those_of_the_table",
        "figures.accuracy.distances:distance_histogram": "test_every_point_is_a_bar_or_counted_beyond",
    },
    "figures/test_footprints.py": {
        "figures.cloud.footprints:footprints": "test_figure_draws_every_footprint_to_scale"
    },
    "figures/test_from_above.py": {
        "figures.cloud.from_above:from_above": "test_bed_and_bank_have_the_colours_of_their_bars"
    },
    "figures/test_frames_by_image.py": {
        "figures.cloud.frames_by_image:frames_by_image": "test_the_figure_says_how_many"
    },
    "figures/test_image_positions.py": {
        "figures.images.photographs:image_positions": "test_everything_is_on_the_map"
    },
    "figures/test_light_sheet_figures.py": {
        "lightsheet.figures.budget:depth_budget": "test_each_cause_has_its_panel",
        "lightsheet.figures.grid_calibration:grid_calibration": "test_the_calibration_shows_what_was_used",
        "lightsheet.figures.lines:line_measurement": "test_methods_are_compared_on_one_line",
        "lightsheet.figures.lines:sheet_image": "test_flags_are_shown_by_their_last_bit",
        "lightsheet.figures.panel_distances:panel_distances": "test_panels_stand_beside_published_values",
        "lightsheet.figures.sensor:measurement_volume_view": "test_the_volume_shows_what_the_sensor_sees",
    },
    "figures/test_line_patch.py": {
        "lightsheet.figures.lines:line_patch": "test_the_template_lies_on_the_line"
    },
    "figures/test_maps_and_clouds.py": {
        "figures.cloud.overview:cloud_detail": "test_detail_by_intensity_names_its_percentiles",
        "figures.cloud.overview:cloud_overview": "test_overview_states_what_it_shows",
        "figures.survey.maps:survey_map": "test_fixes_are_marked_where_the_antenna_was",
    },
    "figures/test_mask_view.py": {
        "figures.images.photographs:mask_view": "test_examples_shares_and_masked_parts_are_shown"
    },
    "figures/test_multi_line_figures.py": {
        "thalweg_lab.figures.multi_line:multi_line_geometry": "test_the_geometry_is_drawn_line_by_line",
        "thalweg_lab.figures.multi_line:multi_line_images_view": (
            "test_images_show_labelled_points_and_those_without"
        ),
    },
    "figures/test_panorama_figures.py": {
        "figures.cloud.coloured:colour_check": "test_the_check_of_clock_and_mount_shows_its_optimum",
        "figures.panorama.rig:rig_field": "test_marks_of_the_field_lie_where_their_angles_say",
        "figures.panorama.rig:rig_residuals": "test_residuals_are_split_along_and_across_the_radius",
    },
    "figures/test_reference_view.py": {
        "figures.accuracy.reference_view:reference_view": "test_figure_names_the_scan_and_counts_its_points"
    },
    "figures/test_removed.py": {
        "figures.cloud.removed:removed_points": "test_one_panel_for_each_reason_with_its_numbers"
    },
    "figures/test_scan_profile.py": {
        "lightsheet.figures.scan_distances:scan_profile": "test_the_line_stands_beside_its_predicted_sigma"
    },
    "figures/test_scan_reference.py": {
        "lightsheet.figures.scan_reference:scan_reference": "test_the_object_and_its_scan"
    },
    "figures/test_scan_setup.py": {
        "lightsheet.figures.scan_setup:scan_setup": (
            "test_the_set_up_shows_camera_panel_sensor_and_three_images"
        )
    },
    "figures/test_sensor_setup.py": {
        "lightsheet.figures.sensor:sensor_setup": "test_ray_and_beam_meet_in_the_water[paper_3]"
    },
    "figures/test_streams_and_errors.py": {
        "figures.survey.streams:streams_in_time": "test_bars_are_spans_on_the_utc_axis"
    },
    "figures/test_trajectory.py": {"figures.survey.maps:trajectory_sheet": "test_sheet_of_a_track_with_gaps"},
    "figures/test_trajectory_comparison.py": {
        "figures.solutions.comparison:chain_histograms": "test_histograms_are_normalised",
        "figures.solutions.comparison:chains_by_range": "test_ranges_of_all_chains",
    },
}

"""Test by file and function that gives an example of a figure function."""

NO_EXAMPLE = {
    "figures.survey.strips:corrections": "a whole adjustment: tests/lidar/test_strips.py",
    "figures.survey.strips:distances": "a whole adjustment: tests/lidar/test_strips.py",
    "figures.bathymetry.pictures:bed_picture": "a bed and its rasters: tests/workflow/test_tiny.py",
    "figures.bathymetry.pictures:draw_bed_map": "a whole survey: tests/workflow/test_files_of_others.py",
    "thalweg_lab.figures.bed_patterns:draw_bed_patterns": "a study: tests/lab/studies/test_bed_study.py",
    "figures.bathymetry.pictures:draw_bed_sections": "a whole survey: tests/workflow/test_tiny.py",
    "figures.bathymetry.terrain:draw_terrain_model": "a whole survey: tests/workflow/test_tiny.py",
    "thalweg_lab.figures.cone_frame:cone_frame": "a sketch without inputs",
    "figures.style:empty_figure": "the sentence itself",
    "lightsheet.figures.sensor:sheet_deformation": "a sketch without inputs",
    "thalweg_lab.figures.joint_river:joint_river_figure": "a study: tests/lab/studies/test_joint_study.py",
}
"""Figure functions that no test here calls, and why."""


def _comparison(_):
    return {"table": make_comparison(np.random.default_rng(1), n=400).table}


def _poses(_):
    k = np.arange(5.0)
    rows = {f"{axis}_m": k for axis in "xyz"}
    rows |= {f"sigma_change_{axis}_m": 0.1 + 0 * k for axis in "xyz"}
    names = [f"{i}.jpg" for i in range(5)]
    return {
        "poses": pd.DataFrame({"image": names, "refused": "", "rms_px": k, "check_rms_px": np.nan, **rows})
    }


def _scan(_):
    k = np.arange(300)
    points = {"file": np.where(k < 150, "a.png", "b.png"), "x_m": 1e-4 * (k % 150), "y_m": 1e-3 * (k // 150)}
    points |= {
        "z_m": 0.02,
        "distance_mm": np.sin(k),
        "sigma_mm": 1.0,
        "sigma_own_mm": 0.5,
        "used": k > 3,
        "reason": "",
    }
    return {"distances": pd.DataFrame(points), "facts": {"reference": "mesh"}, "scan": "a", "title": "b"}


def _left_out(folder):
    k = np.arange(40.0)
    rows = {
        "group": np.where(k < 20, "line", "block"),
        "up_m": np.sin(k),
        "predicted_m": np.cos(k),
        "sigma_m": 1.0,
    }
    pd.DataFrame(rows).to_parquet(folder / "predicted.parquet")
    return {"predicted": folder / "predicted.parquet", "title": "a river", "twin": False}


def _profile(folder):
    names = ("s_m", "thalweg_m", "sigma_thalweg_m", "mean_bed_m", "level_m")
    pd.DataFrame({name: np.arange(5.0) for name in names}).to_csv(folder / "profile.csv")
    return {"profile": folder / "profile.csv", "title": "a river", "twin": False}


PAGES = {
    "lidar/test_strips.py": {"figures.survey.strips:strips_page": "test_along_a_wall_nothing_is_told"},
    "figures/test_accuracy_page.py": {
        "figures.accuracy.page:accuracy_page": "test_the_truth_has_a_section_of_its_own"
    },
    "figures/test_bed_strip.py": {
        "lightsheet.figures.page:strip_page": "test_the_page_counts_what_was_left_out"
    },
    "figures/test_calibration_page.py": {
        "figures.calibration.page:calibration_page": "test_the_page_is_whole"
    },
    "figures/test_change_figures.py": {
        "figures.deformation.page:change_page": "test_the_page_holds_all_tables_and_pictures"
    },
    "figures/test_light_sheet_page.py": {
        "lightsheet.figures.page:light_sheet_page": "test_the_page_says_what_was_found_and_what_was_left_out"
    },
    "figures/test_trajectory_comparison.py": {
        "figures.solutions.page:trajectory_comparison_page": "test_the_page_holds_all_chains"
    },
}
"""The same for functions that make a page."""

OWN = {
    "figures.accuracy.cloud:distances_in_plan": _comparison,
    "figures.bathymetry.pictures:draw_left_out": _left_out,
    "figures.bathymetry.terrain:draw_long_profile": _profile,
    "figures.images.fixed_camera:pose_history": _poses,
    "lightsheet.figures.scan_distances:scan_distances": _scan,
}
"""Examples made here."""


def figure_functions():
    """All of them, as ``module:function``; ``thalweg.`` is left out."""
    found = []
    source = Path(__file__).parents[2] / "src"
    for file in sorted(source.glob("**/figures/**/*.py")):
        module = ".".join(file.relative_to(source).with_suffix("").parts).removeprefix("thalweg.")
        found += [
            f"{module}:{node.name}"
            for node in ast.parse(file.read_text(encoding="utf-8")).body
            if isinstance(node, ast.FunctionDef)
            and any(isinstance(each, ast.Name) and each.id == "styled" for each in node.decorator_list)
        ]
    return found


TESTED = [name for name in figure_functions() if name not in NO_EXAMPLE]


@pytest.fixture(scope="module")
def examples(tmp_path_factory):
    """Arguments by figure function, caught from its test: that ends where the figure would be drawn."""
    listed = [*EXAMPLES.items(), *PAGES.items()]
    wanted = {f"{file}::{test}": name for file, of in listed for name, test in of.items()}
    folder = tmp_path_factory.mktemp("examples")
    found = {name: make(folder) for name, make in OWN.items()}

    class Catcher:
        @pytest.hookimpl(hookwrapper=True)
        def pytest_runtest_call(self, item):
            name = wanted[item.nodeid.split("tests/")[-1]]
            draw = inspect.unwrap(function_of(name))
            code, draw.__code__ = draw.__code__, catch.__code__
            try:
                outcome = yield
            finally:
                draw.__code__ = code
            error = outcome.excinfo[1] if outcome.excinfo else None
            if isinstance(error, CaughtError):
                found[name] = dict(inspect.signature(draw).bind(*error.args[0], **error.args[1]).arguments)
            outcome.force_result(None)

    tests = Path(__file__).parents[1]
    pytest.main(
        ["-q", "--no-header", "-p", "no:cacheprovider", f"--basetemp={folder}/x", f"--rootdir={tests.parent}",
         *(str(tests / node) for node in wanted)],
        plugins=[Catcher()],
    )  # fmt: skip
    return found


def test_words_over_ticks_and_legends_are_seen():
    figure = Figure(figsize=(4, 3))
    ax = figure.add_axes((0.2, 0.2, 0.7, 0.6))
    ax.plot([0.0, 1.0], label="a line")
    assert faults(figure, set()) == []
    ax.yaxis.set_label_coords(-0.05, 0.5)
    ax.set_ylabel("over the numbers")
    figure.legend(loc="upper left")
    figure.suptitle("Over the legend", x=0.02, y=0.97, ha="left")
    found = " ".join(faults(figure, set()))
    assert "'over the numbers', '0.4'" in found
    assert "'Over the legend', '<matplotlib.legend.Legend" in found


def test_every_figure_function_is_called_here():
    listed = [*NO_EXAMPLE, *OWN, *(name for of in EXAMPLES.values() for name in of)]
    assert len(listed) == len(set(listed))
    assert set(listed) == set(figure_functions()), "add an example of it, made here or of its test"


def drawn_values(figure):
    """Numbers of all lines, marks, bars and pictures, in their order."""
    found = []
    for ax in figure.axes:
        found += [line.get_xydata() for line in ax.lines]
        found += [each for mark in ax.collections for each in (mark.get_offsets(), mark.get_array())]
        found += [image.get_array() for image in ax.images] + [bar.get_extents() for bar in ax.patches]
    return [np.ma.filled(np.ma.asarray(each, float), np.nan) for each in found if each is not None]


@pytest.mark.parametrize("name", TESTED)
def test_a_figure_is_whole_marked_and_the_same_again(name, examples, look):
    """It says whose data it shows, no word of it leaves the page, and no chance is in it."""
    one, two = (function_of(name)(**examples[name] | {"twin": True}) for _ in range(2))
    pairs = zip(drawn_values(one), drawn_values(two), strict=True)
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)
    assert "digital twin" in look.texts(one)  # afterwards: a layout moves the bars
    look.drawn(one)


@pytest.mark.parametrize("name", TESTED)
def test_what_has_nothing_to_show_is_left_out_with_its_reason(name, examples):
    draw, found, laid_out = function_of(name), [], set()
    for case, make in cases(name, examples[name]):
        try:
            figure, wrong = warned(lambda make=make: draw(**make()))
            like_another = case.endswith(("equal", "empty"))  # one and nan
            wrong += faults(figure, None if like_another else laid_out)
        except NoSuchStateError:
            continue
        except ThalwegError as error:
            wrong = [] if len(str(error)) > 20 else [f"no reason: {error}"]
        except Exception as error:
            wrong = [f"{type(error).__name__}: {error}"]
        found += [f"{case}: {words}" for words in wrong]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("name", [name for of in PAGES.values() for name in of])
def test_pages_say_what_there_is_none_of(name, examples):
    """No table without a row and no word of no number."""
    build, found = function_of(name), []
    for case, make in cases(name, examples[name]):
        if not case.endswith((" empty", " nan", " absent")) or case.startswith("all"):
            continue
        try:
            page, wrong = warned(lambda make=make: build(**make()).html())
        except ThalwegError as error:
            page, wrong = "", [] if len(str(error)) > 20 else [f"no reason: {error}"]
        except Exception as error:
            page, wrong = "", [f"{type(error).__name__}: {error}"]
        wrong += faults_of_page(page)
        found += [f"{case}: {each}" for each in wrong]
    assert not found, "\n".join(found)
