"""Compiles a function with many callees in three quarters of numba's time, to the same code.

numba treats each callee like a function of its own: it optimises it fully together with its own callees, and makes
machine code of it that nobody runs, because the caller is optimised with the callee's unfinished code in it. Here
a callee that Python cannot call is optimised only as far as it becomes smaller, and gets no machine code.

This replaces inner parts of numba, so only the version that it was written for compiles in this manner.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numba
from llvmlite.binding import Linkage
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Flags
from numba.core.compiler_lock import global_compiler_lock
from numba.core.environment import lookup_environment
from numba.core.registry import cpu_target

WRITTEN_FOR = "0.68."
"""Beginning of numba's version. Another version compiles in its own manner."""
OBJECTS = 100_000
"""Number of new objects after which Python looks for garbage. A compilation makes many that stay."""
_FROM_PYTHON = "_ZN7cpython"
_DEFAULTS = {name: option.default for name, option in Flags.options.items()}


class _NoEnvironment:
    """Takes the place of the code generator where a function without machine code would get its environment."""

    def set_env(self, name: str, environment: Any) -> None:
        pass


class _Library(JITCodeLibrary):
    """The code of one function, with that of its callees."""

    _runs = False

    @property
    def codegen(self) -> Any:
        return self._codegen if self._runs else _NoEnvironment()

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout
        for function in module.functions:
            if not function.is_declaration:
                manager, builder = self._codegen._function_pass_manager()
                manager.run(function, builder)

    def _optimize_final_module(self) -> None:
        self._runs = any(
            function.name.startswith(_FROM_PYTHON) and function.linkage == Linkage.external  # others: a callee's
            for function in self._final_module.functions
        )
        if self._runs:
            super()._optimize_final_module()  # type: ignore[no-untyped-call]
        else:
            manager, builder = self._codegen._module_pass_manager(
                loop_vectorize=False, slp_vectorize=False, opt=0, cost="cheap"
            )
            manager.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        linker, variables = self._codegen._rtlinker, [v.name for v in self._final_module.global_variables]
        recursive = linker._unresolved or any(name.startswith(linker.PREFIX) for name in variables)
        loaded = self._shared_module is not None
        self._runs = self._runs or loaded or bool(recursive)
        if not self._runs:
            self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
            self._verify_declare_only_symbols()  # type: ignore[no-untyped-call]
            self._finalized = True
            return
        super()._finalize_final_module()  # type: ignore[no-untyped-call]
        for name in variables:
            environment = lookup_environment(name)
            if environment is not None:  # of a callee
                self.codegen.set_env(name, environment)


@contextmanager
def lean_compilation() -> Iterator[None]:
    """Compile in this manner what this thread compiles within the block. Other threads wait with compiling."""
    flags: Any = Flags

    def values(self: Any) -> dict[str, Any]:  # numba's takes a tenth of the time to compile
        return {**_DEFAULTS, **self._values}

    if not numba.__version__.startswith(WRITTEN_FOR):
        yield
        return
    with global_compiler_lock:
        codegen, thresholds = cpu_target.target_context.codegen(), gc.get_threshold()
        before = flags.values, codegen._library_class
        flags.values, codegen._library_class = values, _Library
        gc.set_threshold(OBJECTS, *thresholds[1:])
        try:
            yield
        finally:
            gc.set_threshold(*thresholds)
            flags.values, codegen._library_class = before
