"""Stable radix sort of 32- and 64-bit keys, for sorting references by position."""

from __future__ import annotations

import numpy as np

from mibvh._jit import njit

#: Bits of a digit. The 2048 places that a pass writes to fit the first-level cache.
_DIGIT = 11

#: Longest run of equal leading digits that is put in order by insertion.
_SHORT_RUN = 24


@njit(allocates=False)
def _pass(source, target, order, other, shift, counts):
    """Move keys and their indices to where their digit puts them; False if all digits agree."""
    n = np.uint64(len(source))
    s = source.dtype.type(shift)
    mask = source.dtype.type((1 << _DIGIT) - 1)
    counts[:] = 0
    for i in range(n):
        counts[np.uint64((source[i] >> s) & mask)] += np.uint32(1)
    if counts[np.uint64((source[0] >> s) & mask)] == n:
        return False
    place = np.uint32(0)
    for d in range(len(counts)):
        size = counts[d]
        counts[d] = place
        place += size
    for i in range(n):
        key = source[i]
        d = np.uint64((key >> s) & mask)
        place = counts[d]
        counts[d] = place + np.uint32(1)
        target[place] = key
        other[place] = order[i]
    return True


@njit(allocates=False)
def _sort_digits(keys, order, other_keys, other, low, high, counts):
    """Sort by bits ``low`` to ``high``. Whether the result ended up in the other arrays."""
    swapped = False
    for shift in range(low, high, _DIGIT):
        if swapped:
            swapped ^= _pass(other_keys, keys, other, order, shift, counts)
        else:
            swapped ^= _pass(keys, other_keys, order, other, shift, counts)
    return swapped


@njit
def sort_keys(keys, bits):
    """Sort unsigned integer keys, stably.

    Where three digits tell most keys apart, as they do for a million Morton codes, only
    the three leading digits are sorted by; the short runs of keys that agree in them are
    put in order by insertion, long ones by their own radix sort.

    Parameters
    ----------
    keys : (N,) uint32 or uint64
    bits : int
        How many low bits of the keys differ at all.

    Returns
    -------
    keys : (N,) uint32 or uint64
        Sorted.
    order : (N,) int32
        The permutation that sorts.
    """
    n = len(keys)
    source, target = keys.copy(), np.empty_like(keys)
    order, other = np.empty(n, np.int32), np.empty(n, np.int32)
    for i in range(n):
        order[i] = i
    counts = np.empty(1 << _DIGIT, np.uint32)
    low = max(0, (bits - 1) // _DIGIT * _DIGIT - 2 * _DIGIT)
    if _sort_digits(source, order, target, other, low, bits, counts):
        source, target = target, source
        order, other = other, order
    if low == 0:
        return source, order
    s = source.dtype.type(low)
    begin = 0
    while begin < n:
        lead = source[begin] >> s
        end = begin + 1
        while end < n and source[end] >> s == lead:
            end += 1
        if end - begin > _SHORT_RUN:
            if _sort_digits(
                source[begin:end],
                order[begin:end],
                target[begin:end],
                other[begin:end],
                0,
                low,
                counts,
            ):
                # Item by item: Numba takes two seconds to compile what it would say of slices.
                for i in range(begin, end):
                    source[i], order[i] = target[i], other[i]
        else:
            for i in range(begin + 1, end):
                key, index, j = source[i], order[i], i
                while j > begin and source[j - 1] > key:
                    source[j], order[j] = source[j - 1], order[j - 1]
                    j -= 1
                source[j], order[j] = key, index
        begin = end
    return source, order


@njit
def argsort_keys(keys, bits):
    """Sort unsigned integer keys; return the permutation as int32 (stable).

    Parameters
    ----------
    keys : (N,) uint32 or uint64
    bits : int
        How many low bits of the keys differ at all.
    """
    return sort_keys(keys, bits)[1]


@njit
def float_keys(values):
    """Map float32 to uint32 keys of the same order (minus zero taken as zero).

    Parameters
    ----------
    values : (N,) float32
    """
    bits = (values + np.float32(0)).view(np.int32)
    keys = np.empty(len(bits), np.uint32)
    for i in range(len(bits)):
        # Flip the sign bit of positive numbers, all bits of negative ones.
        flip = (bits[i] >> np.int32(31)) | np.int32(-0x80000000)
        keys[i] = np.uint32(bits[i] ^ flip)
    return keys
