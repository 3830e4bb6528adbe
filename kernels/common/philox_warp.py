"""Philox4x32-10 as a Warp function (Salmon et al. 2011, section 3.3)."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  imported only by modules that a Warp device launches

MULTIPLIER_A = wp.constant(wp.uint64(0xD2511F53))
MULTIPLIER_C = wp.constant(wp.uint64(0xCD9E8D57))
WEYL_LOW = wp.constant(wp.uint32(0x9E3779B9))  # golden ratio
WEYL_HIGH = wp.constant(wp.uint32(0xBB67AE85))  # sqrt(3) - 1
Words = wp.types.vector(length=4, dtype=wp.uint32)


@wp.func
def philox(
    pixel: wp.uint32,
    draw: wp.uint32,
    frame: wp.uint32,
    stream: wp.uint32,
    key_low: wp.uint32,
    key_high: wp.uint32,
):
    """Return four random words; key: the low and the high half of the seed."""
    a, b, c, d = pixel, draw, frame, stream
    k0, k1 = key_low, key_high
    for _ in range(10):
        first = wp.uint64(a) * MULTIPLIER_A
        second = wp.uint64(c) * MULTIPLIER_C
        a = wp.uint32(second >> wp.uint64(32)) ^ b ^ k0
        b = wp.uint32(second)
        c = wp.uint32(first >> wp.uint64(32)) ^ d ^ k1
        d = wp.uint32(first)
        k0 += WEYL_LOW
        k1 += WEYL_HIGH
    return Words(a, b, c, d)
