"""One frequency per thread."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

wp.set_module_options({"enable_backward": False})


@wp.kernel
def near(
    # in:
    tables: wp.array4d[float],
    energies: wp.array2d[float],
    down: wp.array2d[float],
    across: wp.array2d[float],
    # out:
    out: wp.array4d[float],
    # sizes:
    rows: int,
    cols: int,
    sigmas: int,
):
    plane, y, x = wp.tid()
    group = plane / tables.shape[1]
    own = plane % tables.shape[1]
    total = float(0.0)
    for sigma in range(sigmas):
        total += energies[plane, sigma] * down[sigma, y] * across[sigma, x]
    out[group, own, y, x] = tables[group, own, y, x] - total
