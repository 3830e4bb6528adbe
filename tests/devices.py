"""The devices that tests run on: every one there is. One that does not work fails its tests, it is not skipped."""

import pytest

from gpusim.backends.probe import devices

_ENTRIES = [entry for entry in devices() if entry["name"] != "numpy"]
DEVICES = [entry["name"] for entry in _ENTRIES]
ALL = ["numpy", *DEVICES]

# Stages run on all of them. What is longer runs on one of each kind, and with `-m slow` on a second driver for the same
# processor (PoCL beside PoCL, say).
_KINDS = [(entry["name"].partition(":")[0], entry["gpu"]) for entry in _ENTRIES]
KINDS = [name if kind not in _KINDS[:number] else pytest.param(name, marks=pytest.mark.slow)
         for number, (name, kind) in enumerate(zip(DEVICES, _KINDS, strict=True))]
ALL_KINDS = ["numpy", *KINDS]
