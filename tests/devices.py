"""The devices that tests run on: every one there is. One that does not work fails its tests, it is not skipped."""

from gpusim.backends.probe import devices

DEVICES = [entry["name"] for entry in devices() if entry["name"] != "numpy"]
ALL = ["numpy", *DEVICES]
