"""What a test may cost, counted in processor time: waiting for a busy machine is not in it."""

import time

import pytest

BUDGET = 300  # [s] of all threads of a test or of the fixtures made for it; the slowest took 120 on a busy machine


def budgeted(item):
    """Around a test's set-up or its call: fail it beyond the budget, unless it is marked slow."""
    start = time.process_time()
    result = yield
    seconds = time.process_time() - start
    if seconds > BUDGET and not item.get_closest_marker("slow"):
        pytest.fail(
            f"{seconds:.0f} s of processor time, {BUDGET} s are allowed: make it cheaper, or mark it slow"
        )
    return result
