"""Faster compilation with numba: functions that only compiled code calls, and only the compiler passes that are needed.

numba makes each function callable from Python, and optimises and translates it together with all functions that it
calls. So a function of the filter would be optimised once for each function above it in the call graph. Here only
functions that Python calls are optimised and translated; a function called by compiled code is a *part*, whose LLVM
code is linked once into each of them.

Half of the remaining time is numba's Python code. It builds a tuple of all columns where one column is named, resolves
the types of each operator again, looks up its implementation, and searches for closures and loops to unroll. Here
columns are constants, resolved types are remembered, numbers and array elements have a short path, and passes that the
filter's code does not need are left out. The results are the same, to the last bit.
"""
from __future__ import annotations

import functools
import operator

from numba.core import compiler, event, ir, lowering, sigutils, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import FunctionPass, PassManager, register_pass
from numba.core.ir_utils import build_definitions, get_definition, guard
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import (
    IRLegalization,
    NativeLowering,
    NoPythonBackend,
    NopythonTypeInference,
    PreLowerStripPhis,
)
from numba.core.typing import Context, make_concrete_template
from numba.core.untyped_passes import (
    FixupArgs,
    GenericRewrites,
    InlineInlinables,
    IRProcessing,
    ReconstructSSA,
    TranslateByteCode,
)
from numba.cpython import numbers
from numba.np import arrayobj

#: types for which the result type of an operator or function does not depend on the value
_PLAIN = types.Number, types.Boolean, types.Array
#: exceptions: numba replaces a power with a constant exponent by a product
_BY_VALUE = operator.pow, operator.ipow
#: numba's implementation of an operator for two numbers of one type
_OPERATORS = {
    (getattr(operator, name), kind, kind): getattr(numbers, f'{prefix}_{how}_impl')
    for kind, prefix, signed in ((types.float64, 'real', ''), (types.int64, 'int', 's'))
    for name, how in (('add', 'add'), ('iadd', 'add'), ('sub', 'sub'), ('isub', 'sub'), ('mul', 'mul'), ('imul', 'mul'),
                      ('eq', 'eq'), ('ne', 'ne'), ('lt', f'{signed}lt'), ('le', f'{signed}le'), ('gt', f'{signed}gt'),
                      ('ge', f'{signed}ge'))}


def compile_in_parts(function, options: dict) -> CPUDispatcher:
    """As `numba.njit(**options)(function)`."""
    return _Compiled(function, targetoptions={'nopython': True, 'boundscheck': None, **options},
                     pipeline_class=_Compiler)


class _Compiled(CPUDispatcher):
    """numba's dispatcher, in which a function called by compiled code (a part) is compiled separately from one that
    Python calls.

    A part has no entry point for Python and no cache of its own. It is compiled once for all constant values of its
    arguments; if a constant helps, LLVM uses it in the caller.
    """

    def __init__(self, function, **options):
        super().__init__(function, **options)
        self._parts: dict[tuple, compiler.CompileResult] = {}

    def get_call_template(self, args, kws):
        """Called by numba where compiled code calls this function with arguments of these types."""
        signature, args = self._compiler.fold_argument_types(args, kws)
        args = tuple(types.unliteral(kind) for kind in args)
        if args not in self._parts:
            details = {'dispatcher': self, 'args': args, 'return_type': None}
            with global_compiler_lock, event.trigger_event('numba:compile', data=details):
                self._parts[args] = self._compile_part(args)
        name, signatures = self.py_func.__name__, [part.signature for part in self._parts.values()]
        return make_concrete_template(name, name, signatures), signature, args, {}

    def get_overload(self, sig):
        """Called by numba for the identity of the part that is called."""
        return self._parts[tuple(sigutils.normalize_signature(sig)[0])].entry_point

    def _compile_part(self, args):
        flags = compiler.Flags()
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        library = _Part(self.targetctx.codegen(), self.py_func.__qualname__)
        part = compiler.compile_extra(self.typingctx, self.targetctx, self.py_func, args, None, flags, {}, library,
                                      _Compiler)
        part = part._replace(entry_point=object())
        self.targetctx.insert_user_function(part.entry_point, part.fndesc, [library])
        return part


class _Part(JITCodeLibrary):
    """LLVM code of one part; it is linked into functions that Python calls, and optimised and translated there."""

    def finalize(self):
        self._finalized = True


class _Whole(JITCodeLibrary):
    """LLVM code of a function that Python calls, with all its parts."""

    def finalize(self):
        libraries = self._linking_libraries
        for library in libraries:  # the list grows within the loop
            if isinstance(library, _Part):
                libraries += [called for called in library._linking_libraries if called not in libraries]
        super().finalize()


class _Compiler(compiler.CompilerBase):
    """The passes of numba that the filter's code needs: it has no closures, no `with` and no lists."""

    def __init__(self, typing, target, library, *arguments):
        if library is None:
            library = _Whole(target.codegen(), 'mems_ins_fusion')
            library.enable_object_caching()
        super().__init__(_typing(typing), target, library, *arguments)

    def define_pipelines(self):
        steps = PassManager('mems_ins_fusion')
        for step in (TranslateByteCode, FixupArgs, IRProcessing, InlineInlinables, GenericRewrites, _Columns,
                     ReconstructSSA, NopythonTypeInference, PreLowerStripPhis, IRLegalization, _Lowering,
                     NoPythonBackend):
            steps.add_pass(step, step.name())
        steps.finalize()
        return [steps]


@register_pass(mutates_CFG=False, analysis_only=False)
class _Columns(FunctionPass):
    """Replaces a column given by its name, such as `Nav.TIME`, by its number.

    numba itself would build a tuple of all columns there, with one instruction for each, and take one element of it.
    """

    _name = 'mems_ins_fusion_columns'

    def __init__(self):
        FunctionPass.__init__(self)

    def run_pass(self, state):
        code, found = state.func_ir, False
        blocks = code.blocks.values()
        for block in blocks:
            for statement in block.find_insts(ir.Assign):
                value = statement.value
                if isinstance(value, ir.Expr) and value.op == 'getattr':
                    columns = _columns(guard(get_definition, code, value.value))
                    if value.attr in columns:
                        statement.value, found = ir.Const(columns[value.attr], value.loc), True
        if found:  # remove the tuples
            used = {var.name for block in blocks for statement in block.body for var in statement.list_vars()
                    if not isinstance(statement, ir.Assign) or var is not statement.target}
            for block in blocks:
                block.body = [statement for statement in block.body if not isinstance(statement, ir.Assign)
                              or statement.target.name in used or not _columns(statement.value)]
            code._definitions = build_definitions(code.blocks)
        return found


def _columns(value) -> dict:
    """Numbers by name if `value` is a global named tuple."""
    named = value.value if isinstance(value, (ir.Global, ir.FreeVar)) else None
    return named._asdict() if isinstance(named, tuple) and hasattr(named, '_fields') else {}


class _Typing(Context):
    """numba's typing context, which remembers the result types of operators and functions."""

    __slots__ = ('_found',)

    def __init__(self, context):
        self.__dict__ = context.__dict__
        self._found = {}
        super().refresh()

    def refresh(self):
        """numba itself searches for extensions at each function; the filter uses none."""

    def resolve_function_type(self, func, args, kws):
        is_compiled = isinstance(func, types.Type) and not isinstance(func, types.Function)
        if is_compiled or kws or not all(isinstance(kind, types.Type) or type(kind) is int for kind in args):
            return super().resolve_function_type(func, args, kws)
        if getattr(func, 'typing_key', func) not in _BY_VALUE and all(isinstance(kind, _PLAIN) for kind in args):
            args = tuple(types.unliteral(kind) for kind in args)
        key = func, args
        if key not in self._found:
            self._found[key] = super().resolve_function_type(func, args, kws)
        return self._found[key]

    def resolve_setitem(self, target, index, value):
        key = types.unliteral(target), types.unliteral(index), types.unliteral(value)
        if key not in self._found:
            self._found[key] = super().resolve_setitem(*key)
        return self._found[key]


@functools.cache
def _typing(context):
    return _Typing(context)


class _Lower(lowering.Lower):
    """numba's generation of LLVM code, with a short path for elements of one-dimensional arrays and for operators of
    two numbers of one type. In functions with `_nrt=False` a position is never negative, so that it is not tested
    whether an element is counted from the end."""

    def lower_getitem(self, resty, expr, value, index, signature):
        place = self._place(value, index, signature)
        if place is None:
            return super().lower_getitem(resty, expr, value, index, signature)
        kind = signature.args[0]
        element = arrayobj.load_item(self.context, self.builder, kind, place)
        return self.context.cast(self.builder, element, kind.dtype, resty)

    def lower_setitem(self, target_var, index_var, value_var, signature):
        place = self._place(target_var, index_var, signature)
        if place is None:
            return super().lower_setitem(target_var, index_var, value_var, signature)
        kind = signature.args[0]
        element = self.context.cast(self.builder, self.loadvar(value_var.name), self.typeof(value_var.name), kind.dtype)
        return arrayobj.store_item(self.context, self.builder, kind, element, place)

    def _place(self, array, index, signature):
        """Pointer to the element; None if the short path cannot be used."""
        kind, at = signature.args[:2]
        is_simple = (isinstance(kind, types.Array) and kind.ndim == 1 and kind.layout == 'C'
                     and isinstance(kind.dtype, types.Number) and isinstance(at, types.Integer))
        if not is_simple or self.context.enable_boundscheck:
            return None
        model, whole = self.context.data_model_manager[kind], self.loadvar(array.name)
        size = self.builder.extract_value(whole, (model.get_field_position('shape'), 0))
        position = self.context.cast(self.builder, self.loadvar(index.name), self.typeof(index.name), at)
        if self.flags.nrt:  # functions that create arrays may count elements from the end; those of the filter do not
            position = arrayobj.fix_integer_index(self.context, self.builder, at, position, size)
        return self.builder.gep(self.builder.extract_value(whole, model.get_field_position('data')), [position])

    def lower_binop(self, resty, expr, op):
        signature = self.fndesc.calltypes[expr]
        write = _OPERATORS.get((op, *signature.args))
        if write is None or expr.static_lhs is not ir.UNDEFINED or expr.static_rhs is not ir.UNDEFINED:
            return super().lower_binop(resty, expr, op)
        operands = [self.context.cast(self.builder, self.loadvar(operand.name), self.typeof(operand.name), kind)
                    for operand, kind in zip((expr.lhs, expr.rhs), signature.args)]
        result = write(self.context, self.builder, signature, operands)
        return self.context.cast(self.builder, result, signature.return_type, resty)


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    _name = 'mems_ins_fusion_lowering'

    @property
    def lowering_class(self):
        return _Lower
