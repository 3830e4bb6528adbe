"""Kernels of a CUDA device as one graph. One call starts it, where each kernel would take one of its own.

The functions are those of CUDA's driver: Warp captures and launches graphs, but cannot change a kernel's arguments in
one. https://docs.nvidia.com/cuda/cuda-driver-api/group__CUDA__GRAPH.html
"""

import ctypes
from collections.abc import Sequence
from itertools import groupby
from typing import Any

from gpusim.backends.cuda_driver import call_driver
from gpusim.backends.warp_arrays import capturing
from gpusim.domain.errors import DeviceError

FEWEST = 2  # kernels of a graph
SIZES = "grid_x", "grid_y", "grid_z", "block_x", "block_y", "block_z", "shared_bytes"


class Kernel(ctypes.Structure):
    """CUDA_KERNEL_NODE_PARAMS_v2: a kernel with its arguments."""

    _fields_ = (
        ("function", ctypes.c_void_p),
        *((name, ctypes.c_uint) for name in SIZES),
        ("arguments", ctypes.c_void_p),
        ("extra", ctypes.c_void_p),
        ("kernel", ctypes.c_void_p),
        ("context", ctypes.c_void_p),
    )


def gather_kernels(device, commands: Sequence) -> list:
    """Return what starts these commands in order: a Graph for kernels in a row, other commands as they are."""
    parts: list = []
    for is_kernel, group in groupby(commands, lambda command: hasattr(command, "launch")):
        kernels = list(group)
        is_graph = is_kernel and len(kernels) >= FEWEST
        parts += [Graph(device, kernels)] if is_graph else kernels
    return parts


class Graph:
    """Kernels that one call starts in order. Use it in one thread at a time.

    It is captured when it is first started. A kernel whose arguments have changed gets them before the next start.

    Args:
        device: The WarpDevice.
        commands: Its commands.

    Attributes:
        stage: Stage of the first kernel.
        args: Arguments of all kernels.
    """

    def __init__(self, device, commands: Sequence):
        self.device, self.commands, self.stage = device, commands, commands[0].stage
        self._graph: Any = None
        self._nodes: list[tuple[ctypes.c_void_p, Kernel]] = []
        self._changes: list[int] = []  # of each command's arguments, as the graph has them

    @property
    def args(self) -> tuple:
        return tuple(arg for command in self.commands for arg in command.args)

    def start(self) -> None:
        """Start the kernels. Raises DeviceError."""
        if self.device.is_timed:
            for command in self.commands:
                command.start()
            return
        if self._graph is None:
            self._capture()
        for place, command in enumerate(self.commands):
            if command.changes != self._changes[place]:
                self._set_arguments(place, command)
        self.device._wp.capture_launch(self._graph)

    def _capture(self):
        device = self.device
        wp, stream = device._wp, device.capturing
        with capturing(str(device.wp_device)), device.wp_device.context_guard:
            wp.capture_begin(stream=stream)
            try:
                for command in self.commands:
                    command.launch.launch(stream)
            finally:
                graph = wp.capture_end(stream=stream)
        self._nodes = [(node, _kernel_of(node)) for node in _chain(graph.graph)]
        if len(self._nodes) != len(self.commands):
            raise DeviceError(
                f"{device.name}: a graph of {len(self.commands)} kernels has {len(self._nodes)} nodes"
            )
        self._changes = [command.changes for command in self.commands]
        self._graph = graph

    def _set_arguments(self, place, command):
        node, kernel = self._nodes[place]
        kernel.arguments = ctypes.addressof(command.launch.params_addr)
        run = self._graph.graph_exec
        call_driver("cuGraphExecKernelNodeSetParams_v2", run, node, ctypes.byref(kernel))
        self._changes[place] = command.changes


def _chain(graph) -> list[ctypes.c_void_p]:
    """Return the nodes of a graph that was captured from one stream, in order."""
    nodes: list[ctypes.c_void_p] = []
    following, of = "cuGraphGetRootNodes", graph
    while True:
        count, found = ctypes.c_size_t(1), (ctypes.c_void_p * 1)()
        call_driver(following, of, found, ctypes.byref(count))
        if not count.value:
            return nodes
        of = ctypes.c_void_p(found[0])
        nodes.append(of)
        following = "cuGraphNodeGetDependentNodes"


def _kernel_of(node) -> Kernel:
    kernel = Kernel()
    call_driver("cuGraphKernelNodeGetParams_v2", node, ctypes.byref(kernel))
    return kernel
