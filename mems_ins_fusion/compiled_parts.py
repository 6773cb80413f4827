"""What compiled code calls, compiled apart from what Python calls: half the time, with numba's inside.

numba by itself makes every function ready to be called from Python, and optimises it, down to machine code, together
with all that it calls: what stands at the bottom of the filter goes through LLVM once for each floor above it. Here
that is done for what Python calls; what compiled code calls is a part of it.
"""
from __future__ import annotations

from numba.core import compiler, event, sigutils, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.core.typing import make_concrete_template


def compile_in_parts(function, options: dict) -> CPUDispatcher:
    """As `numba.njit(**options)(function)`."""
    return _Compiled(function, targetoptions={'nopython': True, 'boundscheck': None, **options})


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
        part = compiler.compile_extra(self.typingctx, self.targetctx, self.py_func, args, None, flags, {}, library)
        part = part._replace(entry_point=object())
        self.targetctx.insert_user_function(part.entry_point, part.fndesc, [library])
        return part


class _Part(JITCodeLibrary):
    """LLVM's code of a part and its parts, to be linked into what Python calls, optimised and translated there."""

    def _optimize_final_module(self):
        pass

    def _finalize_final_module(self):
        self._finalized = True
