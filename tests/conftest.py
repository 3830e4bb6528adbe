import os
import sys
from pathlib import Path

import pytest
from budget import budgeted
from measured import SHARED_DATA

HERE = Path(__file__).parent
DATA = HERE / "data"
QUICK = (HERE / "host", HERE / "stages/test_stages.py")  # all that `-m quick` runs, and imports

# Tests start some hundred processes. Without __pycache__ each of them would compile the whole package again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Results do not depend on what earlier runs have left in the user's cache folder.
os.environ["GPUSIM_TABLES"] = ""

# PoCL and OpenBLAS of every worker take all processors: here they share them. PoCL two, so that work-groups meet.
if "PYTEST_XDIST_WORKER_COUNT" in os.environ:
    share = (os.cpu_count() or 1) // int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
    os.environ.setdefault("POCL_MAX_PTHREAD_COUNT", str(max(2, share)))
    os.environ.setdefault(
        "OPENBLAS_NUM_THREADS", str(max(1, share))
    )  # read when NumPy is loaded, which is later


@pytest.fixture(scope="session")
def data():
    """Reference numbers that belong to the tests; data/README.md names their sources."""
    return DATA


@pytest.fixture(scope="session")
def shared_data():
    """Pictures and spectral cubes that are too large, or not free, to be part of the project."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"no folder {SHARED_DATA} with measured scenes")
    return SHARED_DATA


pytest_runtest_setup = pytest.hookimpl(wrapper=True)(budgeted)
pytest_runtest_call = pytest.hookimpl(wrapper=True)(budgeted)

# Whole frames run on one CPU device by default. On the others they are slow tests, but for the files that compare
# devices: stages, updates and outputs are the same on all of them, and so are frames (tests/golden.py).
ON_ALL_DEVICES = (
    "test_batches",
    "test_outputs",
    "test_random_order",
    "test_simulate",
    "test_updates",
)
OTHERS = ("warp:cpu", "numpy")
FIRST_CASES = "test_first_cases_of_a_stage_agree_with_its_reference"


# Tests of many combinations that repeat each other: one in so many is in the default run, the others are slow tests.
# From one group to the next its place moves on by one, so that devices and tolerances, which vary fastest, take turns.
ONE_OF = {
    "test_nothing_is_read_and_nothing_is_stale": 3,
    "test_a_sketch_shows_what_changes": 3,
    "test_a_point_behind_blades_on_all_devices": 3,
    "test_points_land_where_opencv_puts_them": 7,
    "test_a_loops_memory_is_predicted": 3,
    "test_a_draft_is_near_what_is_planned_for_the_lens": 4,
    "test_what_has_no_draft_is_planned": 2,
    "test_items_of_several_scenes": 6,
    "test_items_of_several_settings": 6,
    "test_what_interpolation_errs_is_predicted": 2,
    "test_a_frame_errs_no_more_than_it_says": 6,
    "test_nothing_stale_is_used": 4,
    "test_what_is_behind_a_change_runs_and_nothing_else": 2,
    "test_noise_is_turned_on_and_off": 2,
    "test_promises_are_kept": 4,
    "test_the_truth_is_that_of_the_brute_force": 2,
    "test_borders_of_the_brute_force": 2,
    "test_every_result_is_that_of_a_new_simulator": 2,
    "test_probes_tell_the_true_error_of_a_plans_own_planes": 6,
    "test_all_ways_give_one_frame": 3,
    "test_electrons_are_those_of_the_radiance": 8,
    "test_devices_and_plans_agree": 3,
    "test_a_camera_with_that_lens": 4,
    "test_every_setting_develops_as_the_reference_does": 3,
    "test_irradiance_of_a_flat_scene_is_that_of_the_camera_equation": 3,
    "test_16_bits_are_the_8_bits_and_what_lies_between": 2,
    "test_noise_moves_nothing_at_rest": 4,
    "test_an_option_has_an_effect": 3,
    "test_hard_case": 3,
    "test_mean_electrons_agree_with_the_reference": 4,
    "test_true_error_includes_the_border": 2,
    "test_plans_meet_their_tolerance": 3,
    "test_plans_of_any_light": 3,
    "test_tiny_frames_keep_their_word": 3,
    "test_a_full_disk_is_said_in_one_line": 2,
    "test_a_full_standard_output_is_said_in_one_line": 2,
    "test_a_reader_that_has_gone_ends_the_work_in_silence": 2,
    "test_a_function_and_a_package_have_one_name": 2,
    "test_images_of_an_aberrated_pupil": 2,
    "test_energy_is_kept": 3,
    "test_a_mirrored_mosaic_is_the_mirrored_picture_of_best": 3,
    "test_a_star_keeps_its_energy_between_samples": 2,
    "test_an_encoded_video_in_parts_is_that_of_one_run": 2,
    "test_frames_of_a_world_without_end": 2,
    "test_devices_see_the_same_world": 2,
    "test_filters_leave_white_where_interpolation_has_it": 4,
    "test_an_interrupted_run_leaves_the_data_set_and_goes_on": 2,
    "test_a_given_relative_illumination_is_the_flat_field": 4,
    "test_sums_over_any_pupil_are_those_of_rays": 3,
    "test_ids_and_boxes_land_where_the_light_lands": 2,
    "test_every_path_makes_the_same_bits": 4,
    "test_edges_of_depth_are_those_of_rays": 5,
    "test_a_smear_errs_no_more_than_it_says": 4,
    "test_random_wavefronts_against_quadrature": 3,
    "test_edges_move_as_geometry_says": 3,
    "test_a_fisheye_sees_the_radiance_of_its_rays": 3,
    "test_a_star_has_the_spread_of_its_own_distance": 4,
    "test_merged_reads_are_unbiased_and_as_precise_as_they_can_be": 3,
    "test_a_point_of_1e9_behind_any_pupil": 3,
    "test_frames_of_many_waves": 2,
    "test_hidden_surfaces_are_guessed_and_said": 2,
    "test_a_slope_through_a_lens_that_varies": 3,
    "test_flow_is_the_difference_of_mapped_points": 3,
    "test_stacked_pixels_are_binned_layer_by_layer": 2,
    "test_a_star_is_the_integral_of_the_pupil": 2,
    "test_tables_that_planners_look_at": 2,
    "test_draws_follow_each_other_each_in_an_array_of_its_own": 2,
    "test_the_mosaic_takes_each_pixels_own_channel": 3,
    "test_tiles_of_natural_scenes": 2,
    "test_a_star_in_a_tiny_frame_out_of_focus": 2,
    "test_autofocus_of_an_operated_sensor": 2,
    "test_a_verified_picture": 2,
    "test_no_part_of_a_costly_table_is_lost": 2,
    "test_no_error_of_a_plan_is_taken_from_a_softer_or_darker_scene": 2,
    "test_rendered_frames_are_those_of_rays": 2,
    "test_scene_forms_agree": 2,
    "test_worst_places_are_predicted": 3,
    "test_large_arrays_that_are_dropped_are_freed_if_the_host_works": 2,
    "test_a_star_keeps_its_energy": 2,
    "test_batches_of_captures_have_four_axes_at_most": 3,
    "test_a_stream_has_the_bits_and_plans_of_one_device": 2,
    "test_a_batch_has_the_bits_and_plans_of_one_device": 2,
    "test_large_tables_are_the_integral": 2,
    "test_large_tables_behind_blades_are_the_integral": 2,
    "test_tables_of_many_waves": 3,
    "test_border_is_the_mirrored_mosaic": 3,
    "test_the_exposure_is_that_of_the_downloaded_frame": 3,
    "test_coarse_pixels_err_as_predicted": 2,
    "test_a_frame_that_repeats_the_last_has_the_bits_of_a_new_loop": 2,
    "test_highlights_by_the_border_of_a_displaced_view_are_those_of_its_picture": 2,
    "test_variance_is_that_of_drawn_values": 2,
    "test_stated_error_of_tables_holds": 2,
    "test_stage_agrees_with_its_reference": 2,
}

# Tests of 0.3 s and more on one core, most of which have shorter siblings: slow tests. Measured with empty caches.
LONG = frozenset((HERE / "long.txt").read_text("utf-8").splitlines())


def pytest_ignore_collect(collection_path, config):
    """Import nothing but the quick tests for `-m quick`."""
    if config.option.markexpr == "quick" and collection_path.is_relative_to(HERE):
        if not any(
            place.is_relative_to(collection_path) or collection_path.is_relative_to(place)
            for place in QUICK
        ):
            return True
    return None


def pytest_collection_modifyitems(config, items):
    """Mark as slow: `LONG`; whole frames on a second CPU device, if the first is tested; combinations beyond `ONE_OF`.

    And the first cases of stages, but for `-m quick`: another test runs all cases.
    """
    named, counted = {}, {}
    for item in items:
        if getattr(item, "originalname", "") == FIRST_CASES and config.option.markexpr != "quick":
            item.add_marker("slow")
        if item.get_closest_marker("quick"):
            assert any(item.path.is_relative_to(place) for place in QUICK), item.nodeid
        if hasattr(item, "callspec") and "frames" in item.path.parts:
            params = item.callspec.id.split("-")
            rest = tuple(part for part in params if part not in (*OTHERS, "opencl:0"))
            named.setdefault((item.path, item.originalname, rest), []).append(item)
    for (path, *_), same in named.items():
        devices = {item: [str(one) for one in item.callspec.params.values()] for item in same}
        if path.stem in ON_ALL_DEVICES or not any("opencl:0" in one for one in devices.values()):
            continue
        for item, parts in devices.items():
            if any(other in parts for other in OTHERS):
                item.add_marker("slow")
    for item in items:
        of = ONE_OF.get(getattr(item, "originalname", ""))
        if of and hasattr(item, "callspec") and not item.get_closest_marker("slow"):
            number = counted[item.originalname] = counted.get(item.originalname, -1) + 1
            if number % of != number // of % of:
                item.add_marker("slow")
    for item in items:  # after the others, so that no long sibling takes the place
        if item.nodeid.removeprefix("tests/") in LONG:
            item.add_marker("slow")
