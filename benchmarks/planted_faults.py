"""Plants single faults in the parts that keep a run safe, and prints those that no test notices.

    python -m benchmarks.planted_faults [--n 100] [--seed 1] [--only PART] [--near] [--timeout 600]

A fault changes one expression or statement: a comparison, a condition, a number, a member of a list, an argument,
a call. The faults are drawn at random from all that are possible in PARTS. Each is planted in a copy of the
repository, whose tests of this part are then performed until one fails. The exit code is 0 if all were caught,
else 2. A fault that is not caught needs a test, unless nobody can observe it.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import cache_from_source
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CELL, SKILLS = "tests/unit/cell", "tests/unit/skills"
PARTS = {
    "cell/control": (f"{CELL}/control", f"{CELL}/executive"),
    "cell/executive": (f"{CELL}/executive",),
    "cell/journal": (f"{CELL}/journal", f"{CELL}/runs"),
    "cell/operator/console": (f"{CELL}/operator/console",),
    "cell/runs": (f"{CELL}/runs", f"{CELL}/commands/test_absurd_cells.py", f"{CELL}/commands/test_bad_input.py"),
    "cell/states": (f"{CELL}/states", f"{CELL}/executive"),
    "skills/grasping": (f"{SKILLS}/grasping", f"{CELL}/executive"),
    "skills/perception/inspection": (f"{SKILLS}/perception/inspection", f"{CELL}/executive"),
    "skills/scoring": (f"{SKILLS}/test_score.py",),
}
"""Folder of the product -> its tests, in the order in which they are performed."""
OPPOSITE: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.And: ast.Or, ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip
TEST_S = 150
"""Wall time after which one test counts as failed [s]: a fault may make a loop endless."""
OTHER_NAME = {"min": "max", "max": "min", "any": "all", "all": "any"}


@dataclass(frozen=True)
class Fault:
    """One change of a file: the text between two offsets [bytes of UTF-8] is replaced."""

    file: str
    line: int
    begin: int
    end: int
    before: str
    after: str

    def planted(self, source: str) -> str:
        """Return the source with this fault."""
        data = source.encode()
        return (data[: self.begin] + self.after.encode() + data[self.end :]).decode()

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {_short(self.before)} -> {_short(self.after)}"


def faults(source: str, file: str) -> list[Fault]:
    """Return all faults that can be planted in a source, in the order of their places."""
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []
    for node in _changeable(ast.parse(source)):
        for after in _changed(node):
            begin = starts[node.lineno - 1] + node.col_offset
            end = starts[node.end_lineno - 1] + node.end_col_offset
            text = f"({ast.unparse(after)})" if isinstance(after, ast.expr) else ast.unparse(after)
            found.append(Fault(file, node.lineno, begin, end, source.encode()[begin:end].decode(), text))
    return sorted(found, key=lambda fault: (fault.begin, fault.end, fault.after))


def _changeable(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes in which a fault is possible: neither types, decorators and texts, nor the names that a module
    exports."""
    if isinstance(node, ast.Import | ast.ImportFrom | ast.JoinedStr | ast.AnnAssign) and not (
        isinstance(node, ast.AnnAssign) and node.value is not None
    ):
        return
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id == "__all__":
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name not in {"annotation", "returns", "decorator_list"}:
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _changeable(child)


def _changed(node: ast.AST) -> Iterator[ast.AST]:
    """All faulty forms of a node."""
    if isinstance(node, ast.Compare | ast.BoolOp | ast.BinOp):
        operator = node.ops[0] if isinstance(node, ast.Compare) else node.op
        if type(operator) in OPPOSITE and not (isinstance(node, ast.BinOp) and _is_text(node)):
            other = copy.deepcopy(node)
            if isinstance(other, ast.Compare):
                other.ops[0] = OPPOSITE[type(operator)]()  # type: ignore[call-overload]
            else:
                other.op = OPPOSITE[type(operator)]()  # type: ignore[assignment]
            yield other
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield ast.Constant(node.value + 1 if isinstance(node.value, int) else 1.5 * node.value or 0.01)
    elif isinstance(node, ast.IfExp):
        yield ast.IfExp(node.test, node.orelse, node.body)
    elif isinstance(node, ast.Name) and node.id in OTHER_NAME:
        yield ast.Name(OTHER_NAME[node.id])
    elif isinstance(node, ast.Set | ast.List) and len(node.elts) > 1:
        for n in range(len(node.elts)):
            yield type(node)([e for k, e in enumerate(node.elts) if k != n])
    elif isinstance(node, ast.Call):
        for keyword in node.keywords:
            if keyword.arg is not None and len(node.args) + len(node.keywords) > 1:
                yield ast.Call(node.func, node.args, [k for k in node.keywords if k is not keyword])
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield ast.Pass()


def _is_text(node: ast.AST) -> bool:
    return any(
        isinstance(part, ast.JoinedStr) or (isinstance(part, ast.Constant) and isinstance(part.value, str))
        for part in ast.walk(node)
    )


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= 70 else line[:67] + "..."


def drawn(root: Path, n: int, seed: int, parts: Sequence[str]) -> list[Fault]:
    """Draw n different faults, each of all that are possible in the files of `parts` with the same probability."""
    possible = [
        fault
        for part in parts
        for path in sorted((root / part).rglob("*.py"))
        for fault in faults(path.read_text(encoding="utf-8"), path.relative_to(root).as_posix())
    ]
    return random.Random(seed).sample(possible, n)


def covering_tests(fault: Fault, root: Path, near: bool) -> list[str]:
    """Return the files of tests of the fault's part. Those that name the faulty module come first. near: only
    these, if there are any."""
    part = next(part for part in PARTS if Path(fault.file).is_relative_to(part))
    files = [
        path
        for place in PARTS[part]
        for path in ([root / place] if place.endswith(".py") else sorted((root / place).rglob("test_*.py")))
    ]
    module = fault.file.removesuffix(".py").replace("/", ".")
    naming = [path for path in files if module in path.read_text(encoding="utf-8")]
    files = naming if near and naming else [*naming, *(path for path in files if path not in naming)]
    return [path.relative_to(root).as_posix() for path in files]


def is_caught(fault: Fault, root: Path, near: bool, timeout_s: float) -> bool:
    """Whether a test fails, or never ends, while the fault is planted in the copy `root`."""
    path = root / fault.file
    source = path.read_text(encoding="utf-8")
    _write(path, fault.planted(source))
    tests = covering_tests(fault, root, near)
    line = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", f"--timeout={TEST_S}", *tests]
    environment = {**os.environ, "PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": ""}
    try:
        done = subprocess.run(line, cwd=root, env=environment, capture_output=True, timeout=timeout_s)
        return done.returncode != 0
    except subprocess.TimeoutExpired:
        return True
    finally:
        _write(path, source)


def _write(path: Path, source: str) -> None:
    """Write a source and forget its bytecode, which Python would take for that of a source of the same size that
    was written within the same second."""
    path.write_text(source, encoding="utf-8")
    Path(cache_from_source(str(path))).unlink(missing_ok=True)


def copied(folder: Path) -> Path:
    """Copy the files of the repository, with what is compiled already, and without its runs. The links in
    `foldcell` stay links: a fault that is planted in a file is then in the module that the tests import."""
    root = folder / "repository"
    left_out = shutil.ignore_patterns(".*", "logs", "build", "*.egg-info")
    shutil.copytree(ROOT, root, symlinks=True, ignore=left_out)
    return root


def main(line: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=100, help="number of faults (100)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the draw (1)")
    parser.add_argument("--only", choices=sorted(PARTS), action="append", help="parts (all)")
    parser.add_argument("--near", action="store_true", help="only the tests that name the faulty module (all)")
    parser.add_argument("--timeout", type=float, default=600.0, help="time after which tests count as failed [s]")
    options = parser.parse_args(line)
    missed = []
    with tempfile.TemporaryDirectory(prefix="planted-faults-") as name:
        root = copied(Path(name))
        for fault in drawn(root, options.n, options.seed, options.only or sorted(PARTS)):
            caught = is_caught(fault, root, options.near, options.timeout)
            print("caught    " if caught else "NOT CAUGHT", fault, flush=True)
            missed += [] if caught else [fault]
    print(f"{options.n - len(missed)} of {options.n} caught")
    return 2 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
