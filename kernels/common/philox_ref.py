"""Philox4x32-10: random words as a pure function of (key, counter) on every device.

Source: Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011, section
3.3.
"""

import numpy as np

MULTIPLIERS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
# golden ratio and sqrt(3) - 1: increments of the key each round
WEYL = (np.uint32(0x9E3779B9), np.uint32(0xBB67AE85))
ROUNDS = 10


def philox(counter, key):
    """Return four random words per counter.

    Args:
        counter: Four uint32 arrays or numbers that broadcast; gpusim counts (pixel, draw, frame,
            stream).
        key: Two uint32 numbers, the low and the high half of the seed.

    Returns:
        Four uint32 arrays of the broadcast shape.
    """
    c0, c1, c2, c3 = np.broadcast_arrays(*(np.asarray(word, np.uint32) for word in counter))
    # scalars would warn when they wrap around
    k0, k1 = (np.atleast_1d(np.asarray(word, np.uint32)) for word in key)
    for _ in range(ROUNDS):
        first, second = MULTIPLIERS[0] * c0, MULTIPLIERS[1] * c2
        c0 = _high(second) ^ c1 ^ k0
        c1 = second.astype(np.uint32)
        c2 = _high(first) ^ c3 ^ k1
        c3 = first.astype(np.uint32)
        k0, k1 = k0 + WEYL[0], k1 + WEYL[1]
    return c0, c1, c2, c3


def seed_words(seed: int) -> tuple[int, int]:
    """Split a 64-bit seed into the key: its low and its high 32 bits."""
    return seed & 0xFFFFFFFF, seed >> 32


def signed(word: int) -> int:
    """Return the same 32 bits as a signed number, which is how kernels take integers."""
    return word - 2**32 if word >= 2**31 else word


def chance_word(chance: float, bits: int = 32) -> int:
    """Return the limit that a word of `bits` bits does not exceed with this chance."""
    return max(round(chance * 2**bits), 1) - 1


def _high(product):
    return (product >> np.uint64(32)).astype(np.uint32)
