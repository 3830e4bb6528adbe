"""Lengths of the transforms: what the kernels transform, and how far a mosaic folds into it."""

LENGTHS = tuple(
    sorted(
        2**a * 3**b * 5**c
        for a in range(16)
        for b in range(10)
        for c in range(7)
        if 2**a * 3**b * 5**c <= 2**15
    )
)


def fft_length(minimum: int) -> int:
    """Smallest length not below `minimum` that is a product of 2, 3 and 5 (up to 32768)."""
    return next(length for length in LENGTHS if length >= minimum)


def transform_lengths(minimum, cfa_shape):
    """Transform lengths of at least `minimum` (rows, cols), and whether the mosaic folds into transforms of these.

    cfa_shape: rows and columns of the mosaic's period. Folding takes multiples of it. Lengths are products of 2, 3 and
    5, so a period of 7 cannot be. A length is None where even the largest one is too short.
    """

    def smallest(size, multiple):
        return next(
            (length for length in LENGTHS if length >= size and length % multiple == 0), None
        )

    folded = tuple(smallest(size, period) for size, period in zip(minimum, cfa_shape, strict=True))
    if None in folded:
        return tuple(smallest(size, 1) for size in minimum), False
    return folded, True
