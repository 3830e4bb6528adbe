"""How OpenCL devices launch kernels: the program's text and options, and the pieces of a grid."""

from pathlib import Path
from typing import TypeAlias

from gpusim.backends.device import kernel_folder
from gpusim.domain.errors import DeviceError

# of every program; -w: compilers warn of vectors that the host lacks, which changes nothing here
BUILD_OPTIONS = ("-cl-std=CL1.2", "-cl-fp32-correctly-rounded-divide-sqrt", "-w")
# Work-items of CPU work-groups, one after the other: whole vectors of any width, little overhead
# per group, then the rest. PoCL compiles a kernel for every size of a group, 50 ms each: there are
# few.
CPU_GROUPS = (128, 8, 1)
# of GPU work-groups, by the number of axes
GPU_GROUPS = {1: (256,), 2: (4, 64), 3: (1, 4, 64)}
Piece: TypeAlias = tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]


def program_head(defines: dict, is_gpu: bool) -> str:
    """Return the lines before the text of a program.

    Constants go into the text: PoCL's cache has confused programs that differ only in -D.

    Args:
        defines: The program's constants by name.
        is_gpu: Whether work-items return outside the grid.
    """
    guard = "if (outside) return;" if is_gpu else ""
    lines = {"GUARD(outside)": guard} | dict(sorted(defines.items()))
    return "".join(f"#define {name} {value}\n" for name, value in lines.items())


def split_grid(grid: tuple[int, ...], group: tuple[int, ...] | None, is_gpu: bool) -> list[Piece]:
    """Split a grid into launches (size, group, offset), the slowest axis first.

    A GPU gets one launch, rounded up to whole groups; its kernels return outside the grid (GUARD).
    On a CPU such a return would prevent PoCL from vectorising (3.5x, measured), so GUARD is empty
    there and the grid is exact: whole vectors first, then the rest of the fastest axis, in the same
    few groups for frames of all sizes.

    Args:
        grid: Work-items along each axis.
        group: Work-items of a group along each axis; None for the usual ones.
        is_gpu: Whether the device is a GPU.
    """
    origin = (0,) * len(grid)
    if group is None and is_gpu:
        group = GPU_GROUPS[len(grid)]
    if group is not None:
        rounded = tuple(-(-n // g) * g for n, g in zip(grid, group, strict=True))
        return [(rounded, tuple(group), origin)]
    *outer, fastest = grid
    ones, pieces, done = (1,) * len(outer), [], 0
    for items in CPU_GROUPS:
        more = (fastest - done) // items * items
        if more:
            pieces.append(((*outer, more), (*ones, items), (*origin[1:], done)))
        done += more
    return pieces


def stage_source(stage: str) -> tuple[str, Path]:
    """Return the text of `kernels/<area>/<name>.cl`, and the folder of its include files.

    Raises:
        DeviceError: There is no such file.
    """
    root = kernel_folder()
    path = root.joinpath(*stage.split(".")).with_suffix(".cl")
    if not path.exists():
        raise DeviceError(f"{stage}: no OpenCL kernel; add kernels/{path.relative_to(root)}")
    return path.read_text(), root / "common"
