"""Tests of the host's mathematics: no kernel runs and no device is opened here, so that they answer within a minute."""

from pathlib import Path

import pytest

from gpusim.backends import opencl, probe, warp

# Slower tests, about half of the time: of texts, of the package as a whole, and of statistics and plans.
NOT_QUICK = {
    "test_a_lens_that_varies_over_a_small_frame_is_not_vouched_for",
    "test_a_users_script_passes_a_strict_type_checker",
    "test_collecting_the_host_s_tests_loads_no_driver",
    "test_damaged_files_are_refused",
    "test_deadleaves_correlate_as_theory_says",
    "test_depth_next_to_a_real_lens_is_never_called_met",
    "test_devices_are_listed_in_a_checkout_without_an_editable_install",
    "test_few_files_ask_about_a_lens",
    "test_functions_are_verb_phrases",
    "test_no_files_import_one_another_in_a_circle",
    "test_no_plan_costs_more_than_the_exact_one_and_none_more_where_less_is_asked",
    "test_plans_are_those_of_a_planner_that_keeps_nothing",
    "test_prose_is_plain",
    "test_sfr_of_a_camera_has_all_channels",
    "test_sfr_of_binned_pixels_is_by_their_own_pitch",
    "test_the_bound_of_depth_holds",
    "test_variance_is_that_of_drawn_values",
    "test_what_float32_cannot_hold_float64_does",
    "test_what_is_not_seen_comes_along_the_normals",
}


def pytest_collection_modifyitems(items):
    """Mark as quick, before any other test: those of this folder, but for slow ones and `NOT_QUICK`."""
    for item in items:
        if (
            item.path.is_relative_to(Path(__file__).parent)
            and item.originalname not in NOT_QUICK
            and not item.get_closest_marker("slow")
        ):
            item.add_marker(pytest.mark.quick)


@pytest.fixture(scope="module", autouse=True)  # before any other fixture of the file
def no_device():
    """A device that is opened, used (others may have left one open) or probed fails the test."""

    def refuse(*_, **__):
        raise AssertionError(
            "tests/host works without devices: device='numpy', or this test belongs elsewhere"
        )

    with pytest.MonkeyPatch.context() as patch:
        for device in (opencl.OpenCLDevice, warp.WarpDevice):
            patch.setattr(device, "__init__", refuse)
            patch.setattr(device, "__getattribute__", refuse, raising=False)
        patch.setattr(probe, "_run", refuse)
        yield
