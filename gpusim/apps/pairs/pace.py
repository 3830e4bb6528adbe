"""Rate of a pipeline, and the step that limits it."""

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Pace:
    """Seconds that the threads of a pipeline spent with its steps.

    One thread waits for photographs ("reading"), computes ("computing") and waits until its results
    are taken ("waiting"). Another waits for encoded samples ("encoding") and writes ("writing").
    """

    def __init__(self):
        steps = ("reading", "computing", "waiting", "encoding", "writing")
        self._spent = dict.fromkeys(steps, 0.0)

    @contextmanager
    def during(self, step: str) -> Iterator[None]:
        """Add the time of the block to a step. Each step is of one thread."""
        begun = time.perf_counter()
        try:
            yield
        finally:
            self._spent[step] += time.perf_counter() - begun

    @property
    def limit(self) -> str:
        """Name of the step that the others waited for most; "" before the first sample."""
        spent = self._spent
        # results wait for the slower of the two later steps
        later = "encoding" if spent["encoding"] > spent["writing"] else "writing"
        shares = {
            "reading": spent["reading"],
            "computing": spent["computing"],
            later: spent["waiting"],
        }
        name = max(shares, key=lambda name: shares[name])
        return name if shares[name] > 0 else ""
