"""Reads and writes every element once: the limit with which other kernels are compared."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def copy(data: wp.array[float], out: wp.array[float], count: int):
    i = wp.tid()
    out[i] = data[i]
