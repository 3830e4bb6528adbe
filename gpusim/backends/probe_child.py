"""List the devices, or try one, in the process that `gpusim.backends.probe` starts.

`python -m gpusim.backends.probe_child opencl:0` prints the result as JSON.
"""

import json
import sys
import time

import numpy as np

from gpusim.backends.driver import cl_devices
from gpusim.backends.probe import COPY_BYTES, copy_gbps, identity
from gpusim.backends.select import open_device
from gpusim.backends.warp import start_warp
from gpusim.domain.errors import DeviceError, GpusimError


def _list():
    names, failure = ["warp:cpu"], ""
    try:
        names = [f"opencl:{number}" for number in range(len(cl_devices()))] + names
    except DeviceError as error:  # no pyopencl
        failure = str(error)
    try:
        wp = start_warp()
        names += [f"warp:{device.alias}" for device in wp.get_cuda_devices()]
    except Exception:  # its own entry, warp:cpu, will say why
        pass
    return names, failure


def _describe(name):
    device = open_device(name)
    rate = _numpy_copy_gbps() if device.kind == "numpy" else copy_gbps(device)
    return identity(device) | {"memory": int(device.memory), "copy_gbps": float(rate)}


def _numpy_copy_gbps():
    source, target = np.ones(COPY_BYTES // 4, np.float32), np.ones(COPY_BYTES // 4, np.float32)
    seconds = []
    for _ in range(5):
        start = time.perf_counter()
        np.copyto(target, source)
        seconds.append(time.perf_counter() - start)
    return 2 * COPY_BYTES / min(seconds) / 1e9


def _main(argument):
    if argument == "list":
        print(json.dumps(_list()))
        return
    try:
        found = _describe(argument)
    except Exception as error:  # whatever a driver raises is the reason why the device is unusable
        text = str(error) if isinstance(error, GpusimError) else f"{type(error).__name__}: {error}"
        found = {"error": " ".join(text.split())[:400]}
    print(json.dumps(found))


if __name__ == "__main__":
    _main(sys.argv[1])
