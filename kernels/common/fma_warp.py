"""Multiplies and adds only in registers: the limit of arithmetic."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def fma_chains(out: wp.array[float], a: float, b: float, steps: int, count: int):
    i = wp.tid()
    s0, s1, s2, s3, s4 = float(i), float(i), float(i), float(i), float(i)
    s5, s6, s7, s8, s9 = float(i), float(i), float(i), float(i), float(i)
    for _ in range(steps):
        s0 = s0 * a + b
        s1 = s1 * a + b
        s2 = s2 * a + b
        s3 = s3 * a + b
        s4 = s4 * a + b
        s5 = s5 * a + b
        s6 = s6 * a + b
        s7 = s7 * a + b
        s8 = s8 * a + b
        s9 = s9 * a + b
    out[i] = s0 + s1 + s2 + s3 + s4 + s5 + s6 + s7 + s8 + s9
