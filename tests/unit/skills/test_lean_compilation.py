"""Functions that only compiled code calls get no machine code, and all values are those of a plain compilation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest
from llvmlite.binding import Linkage
from numba.core.registry import cpu_target

from foldcell.skills.lean_compilation import lean_compilation

inner: Any = numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True)


def made_of(compiles: Callable[[], Any], monkeypatch: pytest.MonkeyPatch) -> str:
    """The names of all functions that get machine code while `compiles` runs in a lean compilation."""
    codegen, names = cpu_target.target_context.codegen(), []
    add_module = codegen._add_module

    def add(module: Any) -> Any:
        names.extend(f.name for f in module.functions if not f.is_declaration and f.linkage == Linkage.external)
        return add_module(module)

    monkeypatch.setattr(codegen, "_add_module", add)
    with lean_compilation():
        compiles()
    return " ".join(names)


def test_only_what_python_calls_gets_machine_code(monkeypatch: pytest.MonkeyPatch) -> None:
    @inner
    def only_called(x):
        return np.sum(np.full(4, x))

    @numba.njit
    def also_from_python(x):
        return x + 1.0

    @numba.njit
    def entry(x):
        return only_called(x) + also_from_python(x)

    names = made_of(lambda: entry(2.0), monkeypatch)
    assert "entry" in names and "also_from_python" in names and "only_called" not in names
    assert entry(2.0) == 11.0 and also_from_python(2.0) == 3.0

    @numba.njit
    def later(x):
        return 2.0 * only_called(x)

    assert later(2.0) == 16.0, "compiled plainly, with a callee without machine code"


def test_a_callee_can_raise_and_print(capfd: pytest.CaptureFixture[str]) -> None:
    @inner
    def half(n):
        if n % 2:
            raise ValueError("odd", n)
        print("halved", n)
        return n // 2

    @numba.njit
    def entry(n):
        return half(n)

    with lean_compilation():
        assert entry(4) == 2
    with pytest.raises(ValueError, match="odd") as caught:
        entry(3)
    assert caught.value.args == ("odd", 3) and "halved 4" in capfd.readouterr().out


def test_callees_can_call_each_other() -> None:
    @numba.njit
    def even(n):
        return True if n == 0 else odd(n - 1)

    @numba.njit
    def odd(n):
        return False if n == 0 else even(n - 1)

    @numba.njit
    def entry(n):
        return even(n)

    with lean_compilation():
        assert entry(10) and not entry(7)


def test_the_compiler_is_as_before_afterwards() -> None:
    codegen, flags = cpu_target.target_context.codegen(), numba.core.compiler.Flags
    before = codegen._library_class, flags.values
    with pytest.raises(ZeroDivisionError), lean_compilation():
        raise ZeroDivisionError
    assert (codegen._library_class, flags.values) == before
