"""The first uniform numbers of many random streams at once, one of each sample.

They are those of ``Generator(PCG64(SeedSequence(seed, spawn_key=(number,))))`` to the last bit. numpy makes one stream
after the other, which takes 20 us each; here all go side by side, with the same arithmetic: `SeedSequence`'s mixing of
32-bit words (O'Neill's seed_seq_fe) and PCG XSL-RR 128/64 (O'Neill, HMC-CS-2014-0905, 2014). Both are part of what
numpy promises to keep.
"""

from __future__ import annotations

import numpy as np

POOL = 4  # words
INIT_A, MULT_A, INIT_B, MULT_B = 0x43B0D7E5, 0x931E8875, 0x8B51F9DD, 0x58F38DED
MIX_LEFT, MIX_RIGHT = 0xCA01F9DD, 0x4973F715
MULTIPLIER = 0x2360ED051FC65DA44385DF649FCCF645
WORD, HALF = 2**32 - 1, np.uint64(32)
DOUBLE = 2.0**-53


def first_numbers(seed: int, numbers: np.ndarray, d: int) -> np.ndarray:
    """Return the first d uniform numbers of the streams of samples, shape (n, d).

    Parameters
    ----------
    seed
        Not negative.
    numbers
        Of the samples, shape (n,), below 2^32.
    """
    words = _words(seed, np.asarray(numbers, dtype=np.uint32))
    parts = [(high.astype(np.uint64) << HALF) | low for low, high in zip(words[::2], words[1::2])]
    state, increment = (parts[0], parts[1]), (parts[2], parts[3])
    increment = (
        (increment[0] << np.uint64(1)) | (increment[1] >> np.uint64(63)),
        (increment[1] << np.uint64(1)) | np.uint64(1),
    )
    state = _stepped(_sum(increment, state), increment)
    found = np.empty((len(numbers), d))
    for column in found.T:
        state = _stepped(state, increment)
        high, low = state
        turn, mixed = high >> np.uint64(58), high ^ low
        turned = (mixed >> turn) | (mixed << ((np.uint64(64) - turn) & np.uint64(63)))
        column[:] = (turned >> np.uint64(11)) * DOUBLE
    return found


def _words(seed: int, numbers: np.ndarray) -> list[np.ndarray]:
    """Return the eight words of every stream that `SeedSequence` makes of the seed and its number."""
    entropy = [np.uint32(seed >> shift & WORD) for shift in range(0, max(seed.bit_length(), 1), 32)]
    entropy += [np.uint32(0)] * (POOL - len(entropy))
    constant = INIT_A

    def hashed(value: np.ndarray) -> np.ndarray:
        nonlocal constant
        value = value ^ np.uint32(constant)
        constant = constant * MULT_A & WORD
        value = value * np.uint32(constant)
        return value ^ (value >> np.uint32(16))

    def mixed(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        value = np.uint32(MIX_LEFT) * one - np.uint32(MIX_RIGHT) * other
        return value ^ (value >> np.uint32(16))

    with np.errstate(over="ignore"):  # all products and sums are those of 32 bits
        pool = [hashed(word) for word in entropy[:POOL]]
        for source in range(POOL):
            for target in range(POOL):
                if source != target:
                    pool[target] = mixed(pool[target], hashed(pool[source]))
        for word in (*entropy[POOL:], numbers):
            pool = [mixed(own, hashed(word)) for own in pool]
        constant, found = INIT_B, []
        for k in range(2 * POOL):
            value = pool[k % POOL] ^ np.uint32(constant)
            constant = constant * MULT_B & WORD
            value = value * np.uint32(constant)
            found.append(value ^ (value >> np.uint32(16)))
    return found


def _stepped(state: tuple[np.ndarray, np.ndarray], increment: tuple[np.ndarray, np.ndarray]) -> tuple:
    """Return ``state * MULTIPLIER + increment`` in 128 bits, each a pair of high and low words of 64."""
    high, low = state
    by_high, by_low = np.uint64(MULTIPLIER >> 64), np.uint64(MULTIPLIER & (2**64 - 1))
    top = _high_of_product(low, by_low) + high * by_low + low * by_high
    return _sum((top, low * by_low), increment)


def _sum(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the sum in 128 bits."""
    low = one[1] + other[1]
    return one[0] + other[0] + (low < one[1]), low


def _high_of_product(one: np.ndarray, other: np.uint64) -> np.ndarray:
    """Return the upper 64 bits of a product."""
    word = np.uint64(WORD)
    a, b, c, d = one >> HALF, one & word, other >> HALF, other & word
    middle = a * d + (b * d >> HALF)
    crossed = b * c + (middle & word)
    return a * c + (middle >> HALF) + (crossed >> HALF)
