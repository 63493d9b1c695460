"""How kernels are compiled."""

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np

import mibvh
from mibvh._jit import njit


@njit
def _third(values, place):
    return values[place] + np.uint32(3) * 0.5


@njit
def _all_kinds(values, index):
    return (
        _third(values, 1) + _third(values, index[0]) + _third(values, place=len(values) - 1),
        _third(values, np.uint64(2)),
    )


@njit
def _highest_bit(code):
    return code >> np.uint64(63)


@njit
def _bit_of(codes):
    return _highest_bit(codes[0])


def test_a_callee_is_compiled_once_for_all_signed_integers():
    values, index = np.array([1.0, 2.0, 4.0]), np.array([1], np.int32)
    # Compiled here and now: what comes from the cache knows of no callees.
    caller = numba.njit(_all_kinds.py_func)
    assert caller(values, index) == (2.0 + 2.0 + 4.0 + 3 * 1.5, 4.0 + 1.5)
    # By a constant, int32 and int64; and by uint64, which is not the same in all arithmetic.
    assert sorted(str(place) for _, place in _third.signatures) == ["int64", "uint64"]


def test_unsigned_integers_stay_unsigned():
    assert _bit_of(np.array([1 << 63], np.uint64)) == 1


_KERNEL = """
from typing import NamedTuple
from mibvh._jit import njit
class Two(NamedTuple):
    a: float
    b: float
@njit
def added(two):
    return two.a + two.b
"""


def _run(folder, use):
    found = subprocess.run(
        [sys.executable, "-c", use],
        env={**os.environ, "PYTHONPATH": f"{folder}:{Path(mibvh.__file__).parents[1]}"},
        capture_output=True,
        text=True,
    )
    assert found.returncode == 0, found.stderr
    return found.stdout.split()


def test_a_cache_that_cannot_be_read_is_no_cache(tmp_path):
    """Another version left an index that names a type which is gone; a file is damaged."""
    kernel = tmp_path / "kernel.py"
    kernel.write_text(_KERNEL)
    assert _run(tmp_path, "import kernel; print(kernel.added(kernel.Two(1.0, 2.0)))") == ["3.0"]
    kernel.write_text(_KERNEL.replace("Two", "Pair"))
    use = "import kernel as k; print(k.added(k.Pair(1.0, 2.0)), len(k.added.stats.cache_misses))"
    assert _run(tmp_path, use) == ["3.0", "1"]
    assert _run(tmp_path, use) == ["3.0", "0"], "the new one is found again"
    for file in (tmp_path / "__pycache__").glob("*.nbc"):
        file.write_bytes(b"damaged")
    assert _run(tmp_path, use) == ["3.0", "1"]


_INTRINSIC = """
from numba import types
from numba.extending import intrinsic
@intrinsic
def number(typingctx):
    def generate(context, builder, signature, arguments):
        return context.get_constant(types.int64, NUMBER)
    return types.int64(), generate
"""

_BETWEEN = """
from numba.extending import intrinsic
from numbers_of_mine import number
@intrinsic
def passed_on(typingctx):
    return number._defn(typingctx)
"""

_USER = """
from mibvh._jit import njit
from between import passed_on
@njit
def called():
    return passed_on()
"""


def test_a_changed_intrinsic_is_compiled_anew(tmp_path):
    """Also one that another file's intrinsic is made of."""
    (tmp_path / "between.py").write_text(_BETWEEN)
    (tmp_path / "user.py").write_text(_USER)
    for number in (3, 44):
        (tmp_path / "numbers_of_mine.py").write_text(_INTRINSIC.replace("NUMBER", str(number)))
        assert _run(tmp_path, "import user; print(user.called())") == [str(number)]
