"""What compiled code calls, compiled apart from what Python calls, in the steps that it needs: with numba's inside.

numba by itself makes every function ready to be called from Python, and optimises it, down to machine code, together
with all that it calls: what stands at the bottom of the filter goes through LLVM once for each floor above it. Here
that is done for what Python calls; what compiled code calls is a part of it, linked into it once.

Half of the rest is numba's Python. It makes a tuple of all columns where one is named, asks for each `+` what that may
mean of strings, lists and records, looks up again how it is written down, and looks for closures and loops to unroll.
Here a column is a number, what has been found is remembered, numbers and arrays have a short way, and steps for what
the filter's code does not have are left out. The machine code computes the same, to the last bit.
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

#: types for which an operator or a function means the same for all values
_PLAIN = types.Number, types.Boolean, types.Array
#: but for these: of a constant exponent numba makes a product
_BY_VALUE = operator.pow, operator.ipow
#: how numba writes down an operator for two numbers of one type
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
    """numba's function, of which what compiled code calls (a part) is compiled apart from what Python calls.

    A part has no entry for Python, is not kept by itself, and is one for all values of its arguments that the caller
    knows: where that helps, LLVM makes use of them in the caller.
    """

    def __init__(self, function, **options):
        super().__init__(function, **options)
        self._parts: dict[tuple, compiler.CompileResult] = {}

    def get_call_template(self, args, kws):
        """What numba asks where compiled code calls this function with arguments of these types."""
        signature, args = self._compiler.fold_argument_types(args, kws)
        args = tuple(types.unliteral(kind) for kind in args)
        if args not in self._parts:
            details = {'dispatcher': self, 'args': args, 'return_type': None}
            with global_compiler_lock, event.trigger_event('numba:compile', data=details):
                self._parts[args] = self._compile_part(args)
        name, signatures = self.py_func.__name__, [part.signature for part in self._parts.values()]
        return make_concrete_template(name, name, signatures), signature, args, {}

    def get_overload(self, sig):
        """What numba then knows the called part by."""
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
    """LLVM's code of one part, to be linked into what Python calls, optimised and translated there."""

    def finalize(self):
        self._finalized = True


class _Whole(JITCodeLibrary):
    """LLVM's code of what Python calls, with all its parts."""

    def finalize(self):
        libraries = self._linking_libraries
        for library in libraries:  # which grows within the loop
            if isinstance(library, _Part):
                libraries += [called for called in library._linking_libraries if called not in libraries]
        super().finalize()


class _Compiler(compiler.CompilerBase):
    """Those steps of numba's that the filter's code needs: it has no closures, no `with` and no lists."""

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
    """A column by its name, as `Nav.TIME`, is the number that it is.

    numba by itself makes a tuple of all columns there, with an instruction for each, and then takes one out.
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
        if found:  # the tuples are left over
            used = {var.name for block in blocks for statement in block.body for var in statement.list_vars()
                    if not isinstance(statement, ir.Assign) or var is not statement.target}
            for block in blocks:
                block.body = [statement for statement in block.body if not isinstance(statement, ir.Assign)
                              or statement.target.name in used or not _columns(statement.value)]
            code._definitions = build_definitions(code.blocks)
        return found


def _columns(value) -> dict:
    """Numbers by their names where `value` is a global named tuple of them."""
    named = value.value if isinstance(value, (ir.Global, ir.FreeVar)) else None
    return named._asdict() if isinstance(named, tuple) and hasattr(named, '_fields') else {}


class _Typing(Context):
    """numba's types, which remembers what operators and functions make of which."""

    __slots__ = ('_found',)

    def __init__(self, context):
        self.__dict__ = context.__dict__
        self._found = {}
        super().refresh()

    def refresh(self):
        """numba by itself looks for extensions of it at each function; the filter uses none."""

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
    """numba's writing of LLVM's code, with a short way for an element of an array of one dimension and for two numbers
    of one type. In functions with `_nrt=False` a position is never negative: no element is counted from the end."""

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
        """Pointer to the element; None: it is not so simple."""
        kind, at = signature.args[:2]
        is_simple = (isinstance(kind, types.Array) and kind.ndim == 1 and kind.layout == 'C'
                     and isinstance(kind.dtype, types.Number) and isinstance(at, types.Integer))
        if not is_simple or self.context.enable_boundscheck:
            return None
        model, whole = self.context.data_model_manager[kind], self.loadvar(array.name)
        size = self.builder.extract_value(whole, (model.get_field_position('shape'), 0))
        position = self.context.cast(self.builder, self.loadvar(index.name), self.typeof(index.name), at)
        if self.flags.nrt:  # functions that make no arrays are those of the filter, which counts from the begin
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
