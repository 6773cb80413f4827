"""Vectors of four adjacent numbers of an array, which the processor adds and multiplies with one instruction.

In compiled code `four` reads such a vector and `put` writes one. numba itself uses vector instructions only in loops
that certainly write to other memory than they read, and the functions of the filter read and write the same array. In
Python a vector is an array of four, so functions of numbers can be called with vectors. The results are those of
separate numbers, to the last bit.
"""
from __future__ import annotations

import operator

from numba.core import cgutils, types
from numba.core.datamodel import models, register_default
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.core.typing.templates import signature as signature_of
from numba.extending import type_callable

ir = cgutils.ir  # llvmlite's
LANES = 4


def four(array, at):
    """The elements at to at + 3 of `array`. at: not negative."""
    return array[at:at + LANES].copy()


def put(array, at, values):
    """Write the four `values` to the elements at to at + 3 of `array`. at: not negative."""
    array[at:at + LANES] = values


class _Four(types.Type):
    def __init__(self):
        super().__init__(name='Four')


FOUR = _Four()
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)


@register_default(_Four)
class _Model(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _VECTOR)


def _is_array(kind) -> bool:
    return isinstance(kind, types.Array) and (kind.ndim, kind.layout, kind.dtype) == (1, 'C', types.float64)


@type_callable(four)
def _type_four(context):
    return lambda array, at: FOUR if _is_array(array) and isinstance(at, types.Integer) else None


@type_callable(put)
def _type_put(context):
    return lambda array, at, values: (types.void if _is_array(array) and isinstance(at, types.Integer)
                                      and values == FOUR else None)


def _place(context, builder, kind, array, at):
    data = context.make_array(kind)(context, builder, value=array).data
    return builder.bitcast(builder.gep(data, [at]), _VECTOR.as_pointer())


@lower_builtin(four, types.Array, types.Integer)
def _lower_four(context, builder, signature, arguments):
    return builder.load(_place(context, builder, signature.args[0], *arguments), align=8)


@lower_builtin(put, types.Array, types.Integer, FOUR)
def _lower_put(context, builder, signature, arguments):
    array, at, values = arguments
    builder.store(values, _place(context, builder, signature.args[0], array, at), align=8)
    return context.get_dummy_value()


def _wide(builder, value):
    """A vector with the same number four times."""
    if value.type == _VECTOR:
        return value
    single = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, cgutils.int32_t(0))
    return builder.shuffle_vector(single, single, ir.Constant(ir.VectorType(cgutils.int32_t, LANES), [0] * LANES))


def _register(function, instruction):
    @infer_global(function)
    class Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 2 and FOUR in args and all(kind == FOUR or isinstance(kind, types.Number) for kind in args):
                return signature_of(FOUR, *(kind if kind == FOUR else types.float64 for kind in args))
            return None

    def lower(context, builder, signature, arguments):
        return getattr(builder, instruction)(*(_wide(builder, value) for value in arguments))

    for kinds in ((FOUR, FOUR), (FOUR, types.float64), (types.float64, FOUR)):
        lower_builtin(function, *kinds)(lower)


for _function, _instruction in ((operator.add, 'fadd'), (operator.sub, 'fsub'), (operator.mul, 'fmul')):
    _register(_function, _instruction)
