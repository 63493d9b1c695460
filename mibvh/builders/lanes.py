"""Eight numbers side by side, for Numba kernels that do eight like things at once.

LLVM vectorises a loop over a last axis of eight where it can prove that nothing it writes is
read again, and keeps sums in memory from one trip to the next. Values of these types are in
registers, and LLVM maps eight lanes to whatever the machine has.

Rows of ``(N, 8)`` float32 or float64 arrays are taken without any check of the index.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, register_model

_COUNT = 8


class _LanesType(types.Type):
    """Numba type of eight numbers held in registers."""

    def __init__(self, number: types.Float) -> None:
        self.number = number
        super().__init__(name=f"Lanes8({number})")


@register_model(_LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _vector(kind.number))


def _vector(number: types.Float) -> ir.VectorType:
    return ir.VectorType(ir.FloatType() if number == types.float32 else ir.DoubleType(), _COUNT)


def _row(context: Any, build: Any, array_type: Any, array: Any, row: Any) -> Any:
    data = context.make_array(array_type)(context, build, array).data
    pointer = build.gep(data, [build.mul(row, ir.Constant(row.type, _COUNT))])
    return build.bitcast(pointer, _vector(array_type.dtype).as_pointer())


@intrinsic
def load(typing: Any, array: Any, row: Any) -> Any:
    """Row of an (N, 8) array."""

    def generate(context, build, signature, values):
        return build.load(_row(context, build, signature.args[0], *values), align=4)

    return _LanesType(array.dtype)(array, types.intp), generate


@intrinsic
def store(typing: Any, array: Any, row: Any, lanes: Any) -> Any:
    """Write a row of an (N, 8) array."""

    def generate(context, build, signature, values):
        build.store(values[2], _row(context, build, signature.args[0], *values[:2]), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes), generate


def _run(context: Any, build: Any, array_type: Any, array: Any, first: Any) -> Any:
    data = context.make_array(array_type)(context, build, array).data
    return build.bitcast(build.gep(data, [first]), _vector(array_type.dtype).as_pointer())


@intrinsic
def load_run(typing: Any, array: Any, first: Any) -> Any:
    """Eight numbers of an (N,) array, from the first on."""

    def generate(context, build, signature, values):
        return build.load(_run(context, build, signature.args[0], *values), align=4)

    return _LanesType(array.dtype)(array, types.intp), generate


@intrinsic
def store_run(typing: Any, array: Any, first: Any, lanes: Any) -> Any:
    """Write eight numbers of an (N,) array."""

    def generate(context, build, signature, values):
        build.store(values[2], _run(context, build, signature.args[0], *values[:2]), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes), generate


@intrinsic
def fill(typing: Any, value: Any) -> Any:
    """Return a float32 or float64 value in every lane."""

    def generate(context, build, signature, values):
        result = ir.Constant(_vector(signature.args[0]), ir.Undefined)
        for lane in range(_COUNT):
            result = build.insert_element(result, values[0], ir.Constant(ir.IntType(32), lane))
        return result

    number = types.float32 if value == types.float32 else types.float64
    return _LanesType(number)(number), generate


@intrinsic
def widen(typing: Any, a: Any) -> Any:
    """Return float32 lanes as float64 lanes."""

    def generate(context, build, signature, values):
        return build.fpext(values[0], _vector(types.float64))

    return _LanesType(types.float64)(a), generate


@intrinsic
def add(typing: Any, a: Any, b: Any) -> Any:
    """Return ``a + b``, lane by lane."""

    def generate(context, build, signature, values):
        return build.fadd(*values)

    return a(a, b), generate


@intrinsic
def subtract(typing: Any, a: Any, b: Any) -> Any:
    """Return ``a - b``, lane by lane."""

    def generate(context, build, signature, values):
        return build.fsub(*values)

    return a(a, b), generate


@intrinsic
def multiply(typing: Any, a: Any, b: Any) -> Any:
    """Return ``a * b``, lane by lane."""

    def generate(context, build, signature, values):
        return build.fmul(*values)

    return a(a, b), generate


@intrinsic
def least(typing: Any, a: Any, b: Any) -> Any:
    """Return the lesser of each two, lane by lane."""

    def generate(context, build, signature, values):
        return build.select(build.fcmp_ordered("<", *values), *values)

    return a(a, b), generate


@intrinsic
def greatest(typing: Any, a: Any, b: Any) -> Any:
    """Return the greater of each two, lane by lane."""

    def generate(context, build, signature, values):
        return build.select(build.fcmp_ordered(">", *values), *values)

    return a(a, b), generate


@intrinsic
def where_at_most(typing: Any, a: Any, b: Any, then: Any, otherwise: Any) -> Any:
    """Return ``then`` where ``a <= b`` and ``otherwise`` elsewhere, lane by lane."""

    def generate(context, build, signature, values):
        return build.select(build.fcmp_ordered("<=", *values[:2]), *values[2:])

    return then(a, b, then, otherwise), generate
