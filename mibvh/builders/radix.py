"""Stable radix sort of 32- and 64-bit keys, for sorting references by position."""

from __future__ import annotations

import numpy as np

from mibvh._jit import njit


@njit
def argsort_keys(keys, bits):
    """Sort unsigned integer keys; return the permutation as int32 (stable).

    Parameters
    ----------
    keys : (N,) uint32 or uint64
    bits : int
        How many low bits of the keys differ at all.
    """
    n = len(keys)
    order = np.arange(n).astype(np.int32)
    other = np.empty(n, np.int32)
    source = keys.copy()
    target = np.empty_like(source)
    mask = source.dtype.type(2047)
    counts = np.empty(2049, np.int64)
    for shift in range(0, bits, 11):
        s = source.dtype.type(shift)
        counts[:] = 0
        for i in range(n):
            counts[((source[i] >> s) & mask) + 1] += 1
        if counts.max() == n:
            continue
        for d in range(2048):
            counts[d + 1] += counts[d]
        for i in range(n):
            d = (source[i] >> s) & mask
            place = counts[d]
            counts[d] = place + 1
            target[place] = source[i]
            other[place] = order[i]
        order, other = other, order
        source, target = target, source
    return order


def float_keys(values):
    """Map float32 to uint32 keys of the same order (minus zero taken as zero).

    Parameters
    ----------
    values : (N,) float32
    """
    bits = (values + np.float32(0)).view(np.uint32)
    return bits ^ np.where(bits >> 31, np.uint32(0xFFFFFFFF), np.uint32(0x80000000))
