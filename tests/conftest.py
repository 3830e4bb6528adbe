import os
from pathlib import Path

import pytest
from budget import budgeted
from measured import SHARED_DATA

DATA = Path(__file__).parent / "data"


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


# Tests of many combinations that repeat each other: one of so many is in the default run, the others are slow tests.
ONE_OF = {
    "test_nothing_is_read_and_nothing_is_stale": 2,
    "test_points_land_where_opencv_puts_them": 3,
    "test_a_loops_memory_is_predicted": 2,
    "test_a_draft_is_near_what_is_planned_for_the_lens": 3,
    "test_items_of_several_scenes": 2,
    "test_items_of_several_settings": 2,
    "test_what_interpolation_errs_is_predicted": 2,
    "test_a_frame_errs_no_more_than_it_says": 3,
    "test_nothing_stale_is_used": 2,
    "test_promises_are_kept": 2,
    "test_every_result_is_that_of_a_new_simulator": 2,
    "test_probes_tell_the_true_error_of_a_plans_own_planes": 3,
    "test_all_ways_give_one_frame": 3,
    "test_electrons_are_those_of_the_radiance": 4,
    "test_devices_and_plans_agree": 3,
    "test_a_camera_with_that_lens": 2,
    "test_every_setting_develops_as_the_reference_does": 2,
    "test_irradiance_of_a_flat_scene_is_that_of_the_camera_equation": 3,
    "test_16_bits_are_the_8_bits_and_what_lies_between": 2,
    "test_noise_moves_nothing_at_rest": 2,
    "test_an_option_has_an_effect": 2,
}


def pytest_collection_modifyitems(items):
    """Mark as slow: whole frames on a second CPU device, if the first is tested too; combinations beyond `ONE_OF`."""
    named, counted = {}, {}
    for item in items:
        params = getattr(item, "callspec", None)
        if params is not None and "frames" in item.path.parts:
            rest = tuple(part for part in params.id.split("-") if part not in (*OTHERS, "opencl:0"))
            named.setdefault((item.path, item.originalname, rest), []).append(item)
        if (
            params is not None
            and item.originalname in ONE_OF
            and not item.get_closest_marker("slow")
        ):
            number = counted[item.originalname] = counted.get(item.originalname, -1) + 1
            if number % ONE_OF[item.originalname]:
                item.add_marker("slow")
    for (path, *_), same in named.items():
        devices = {item: [str(one) for one in item.callspec.params.values()] for item in same}
        if path.stem in ON_ALL_DEVICES or not any("opencl:0" in one for one in devices.values()):
            continue
        for item, parts in devices.items():
            if any(other in parts for other in OTHERS):
                item.add_marker("slow")
