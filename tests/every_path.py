"""What a device makes by every path to frames: two devices of one make give the same bits."""

import numpy as np

import gpusim as gs
from gpusim.backends.probe import copy_gbps

SIZE, SECONDS = (40, 32), 0.01


def scenes(count=3):
    return [gs.chart("ramp", size=SIZE, luminance=20.0 * (1 + number)) for number in range(count)]


def made_on(device, tolerance=4e-4, camera="phone") -> dict:
    """Name of a path -> what it makes, as NumPy's. device: an open one or its name. Each is timed once, too."""
    simulator = gs.Simulator(gs.open_camera(camera), device=device, tolerance=tolerance)
    device, first = simulator.device, scenes()
    assert copy_gbps(device) > 0  # as `gpusim devices` tries it
    loop, found = simulator.loop(first[0], SECONDS), {}
    for number in range(3):  # noted, and replayed
        with device.timed() as ms:
            found[f"raw {number}"] = loop.raw(seed=3, first=number)
        assert ms and all(spent >= 0 for spent in ms.values())
    found["codes"], found["irradiance"] = loop.codes(seed=3), loop.output("irradiance")
    found["another scene"] = loop.update(scene=first[1]).raw(seed=3)
    found = taken(device, found)
    made = simulator.stream(first, "raw", seed=3, exposure_time=SECONDS)
    found |= {
        f"stream {number}": taken(device, {"": frame})[""] for number, frame in enumerate(made)
    }
    found["metered"] = np.stack(
        list(taken(device, dict(enumerate(simulator.stream(first, "raw", seed=3)))).values())
    )
    found |= taken(
        device, {"batch": simulator.batch(len(first), "raw")(first, seed=3, exposure_time=SECONDS)}
    )
    frame = simulator(first[2], seed=3)
    found |= {"simulate": frame.raw, "picture": frame.rgb}
    # of a network: pictures of linear RGB, channels first
    pictures = np.random.default_rng(5).random((2, 3, *SIZE[::-1])).astype(np.float32)
    found["batch of pictures"] = gs.PictureBatch(simulator.camera, device=device, output="linear")(
        pictures, seed=3
    )
    values = device.pinned((3, 5))  # arrays on their way, and back
    values[:] = np.arange(15).reshape(3, 5)
    transfer = device.send(values)
    target = device.stack([transfer.join(), device.array(values)])
    found["transfers"] = device.fetch(target)()
    transfer.wait()
    again = device.send(values, device.empty((3, 5)), after=device.mark())
    found["sent again"] = taken(device, {"": again.join()})[""]
    return found


def taken(device, arrays):
    return {name: np.array(device.numpy(array)) for name, array in arrays.items()}


def require_equal(one, other):
    assert one.keys() == other.keys()
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)
        assert np.ptp(np.asarray(values, float)) > 0, name
