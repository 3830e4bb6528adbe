"""Frame rate of the preview at a client: produced, encoded, sent and acknowledged frames.

    python bench/preview.py deadleaves --size 1920x1080 --camera phone --device opencl [--seconds 5] [--clients 2]

Unknown arguments go to `gpusim preview`, which runs in a separate process. The client acknowledges
each frame immediately and does not decode it. A row for each client, one after the other. The last row is the
memory of the server (Linux) after the last client has left, and its memory is freed.
"""

import argparse
import os
import re
import socket
import struct
import subprocess
import sys
import time
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np
from websockets.sync.client import connect

from gpusim.apps.preview.sessions import AWAY


def started(arguments):
    """Yield a server's process and its address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    process = subprocess.Popen(
        [sys.executable, "-m", "gpusim", "preview", *arguments, "--port", str(port)]
    )
    address = f"http://127.0.0.1:{port}"
    for _ in range(1200):
        try:
            urlopen(address, timeout=5).close()
            return process, address
        except (URLError, ConnectionError, TimeoutError):
            if process.poll() is not None:
                break
            time.sleep(0.1)
    sys.exit("gpusim preview has not started")


def frames(address, seconds):
    """Return the arrival times [s] and sizes [byte] of a page's frames."""
    with urlopen(address, timeout=60) as page:
        token = re.search(r"/picture/([\w-]+)", page.read().decode())[1]
    times, sizes, numbers = [], [], []
    with connect(
        f"{address.replace('http', 'ws')}/picture/{token}", origin=address, max_size=2**26
    ) as client:
        begun = None
        while begun is None or time.perf_counter() - begun < seconds:
            data = client.recv(timeout=60)
            client.send("1")
            numbers.append(struct.unpack("<III", data[:12])[0])
            begun = (
                time.perf_counter() if len(numbers) == 20 else begun
            )  # the first ones build kernels
            if begun is not None:
                times.append(time.perf_counter())
                sizes.append(len(data))
    return np.array(times), np.array(sizes)


def main():
    """Print the rate."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--seconds", type=float, default=5.0)
    options.add_argument("--clients", type=int, default=2)
    asked, arguments = options.parse_known_args()
    process, address = started(arguments)
    try:
        for _ in range(asked.clients):
            times, sizes = frames(address, asked.seconds)
            gaps = 1e3 * np.diff(times)
            print(
                f"{1e3 / gaps.mean():.1f} frames/s, gaps of {np.median(gaps):.1f} ms (95 %: "
                f"{np.percentile(gaps, 95):.1f}), {sizes.mean() / 1024:.0f} KiB a frame"
            )
        time.sleep(AWAY + 5)
        if sys.platform == "linux":
            with open(f"/proc/{process.pid}/statm") as file:
                pages = int(file.read().split()[1])
            print(f"{pages * os.sysconf('SC_PAGE_SIZE') / 2**20:.0f} MiB after all have left")
    finally:
        process.terminate()
        process.wait()


if __name__ == "__main__":
    main()
