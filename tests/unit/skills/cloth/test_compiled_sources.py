"""The fingerprint of the compiled loop: a missing source file would leave stale code in the cache."""

import ast
from importlib import import_module
from pathlib import Path

from numba.core.dispatcher import Dispatcher

from foldcell.skills.cloth import kernel

FOLDER = Path(kernel.__file__).parent


def modules_of(name):
    """The modules of skills/cloth that one of its files imports."""
    for node in ast.walk(ast.parse((FOLDER / name).read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("foldcell.skills.cloth."):
            yield f"{node.module.removeprefix('foldcell.skills.cloth.').replace('.', '/')}.py"


def test_every_source_file_of_the_compiled_loop_is_in_its_fingerprint():
    reached, ahead = set(), ["kernel.py"]
    while ahead:
        name = ahead.pop()
        if name not in reached:
            reached.add(name)
            ahead.extend(modules_of(name))
    marks = "numba", "llvmlite", "@inner"
    compiled = {n for n in reached if any(mark in (FOLDER / n).read_text() for mark in marks)}
    assert compiled <= set(kernel.COMPILED), compiled - set(kernel.COMPILED)
    assert set(kernel.COMPILED) <= reached
    assert {"simd/f32x16.py", "simd/vec3.py", "broad_phase/cluster_search.py"} <= compiled


def test_contractible_kernels_use_no_power_operator():
    """numba compiles x ** 2 once per process, with the options of the first caller. A product gives the same sums
    whatever was compiled before."""
    powers = [
        f"{name}:{node.lineno}"
        for name in kernel.COMPILED
        for function in ast.walk(ast.parse((FOLDER / name).read_text()))
        if isinstance(function, ast.FunctionDef)
        and any("fastmath" in ast.unparse(d) for d in function.decorator_list)
        for node in ast.walk(function)
        if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.Pow)
    ]
    assert powers == []


def test_only_what_python_calls_is_compiled_with_conversions_from_python():
    """They were a fifth of the time to compile, and a tuple of arrays makes a one-line function take seconds."""
    modules = [import_module(f"foldcell.skills.cloth.{n[:-3].replace('/', '.')}") for n in kernel.COMPILED]
    functions = {f for module in modules for f in vars(module).values() if isinstance(f, Dispatcher)}
    called = {f.py_func.__name__ for f in functions if not f.targetoptions.get("no_cpython_wrapper")}
    assert called == {"run_frames", "advance_set", "_scan", "crosses", "judge_sides", "blocks"}
