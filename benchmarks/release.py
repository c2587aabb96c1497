"""Check that this commit can be released: `make release`, or

    python -m benchmarks.release

Builds the packages of the last commit, installs the wheel into an environment of its own, folds a towel there and
removes it again. Prints one line per check. The exit code is 0 if all are good, else 2.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import urllib.request
import venv
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePath

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("cell", "skills", "robots", "calibration")
LARGEST_WHEEL = 3_000_000
"""[bytes]"""
MAY_WRITE = (PurePath(".cache"), PurePath(".local/share/foldcell"))
"""The folders below the user's home into which an installed program writes: caches, and its logs."""


def main() -> int:
    """Perform all checks. The texts are those whose tests lie directly in tests/unit."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    found = [
        _say("tree", [f"not committed: {line}" for line in _lines("git", "status", "--porcelain")]),
        _say("tag", tag_problems(_lines("git", "tag", "--points-at", "HEAD"), version)),
        _say("changelog", changelog_problems((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), version)),
        _say(
            "texts", _run([sys.executable, "-m", "pytest", *map(str, sorted(ROOT.glob("tests/unit/test_*.py")))])
        ),
    ]
    with tempfile.TemporaryDirectory() as folder:
        tree, out = Path(folder) / "tree", Path(folder) / "dist"
        copy_tree(tree)
        found.append(_say("build", built := build_packages(tree, out)))
        if not built:
            (wheel,) = out.glob("*.whl")
            found.append(_say(f"wheel, {wheel.stat().st_size / 1e6:.1f} MB", wheel_problems(wheel, tree)))
            found.append(_say("fold from the wheel", try_wheel(wheel, Path(folder) / "trial")))
    return 2 if any(found) else 0


def _say(name: str, problems: Sequence[str]) -> Sequence[str]:
    for line in [f"BAD   {name}: {problem}" for problem in problems] or [f"ok    {name}"]:
        print(line, flush=True)
    return problems


def tag_problems(tags: Sequence[str], version: str) -> list[str]:
    if f"v{version}" in tags:
        return []
    return [f"the tags of this commit are {', '.join(tags) or 'none'}: v{version} is due"]


def changelog_problems(text: str, version: str) -> list[str]:
    """The first section has to be that of the version, with its date."""
    heading = next(iter(re.findall(r"^## (.*)$", text, re.M)), "none")
    if re.fullmatch(rf"{re.escape(version)} \(\d{{4}}-\d\d-\d\d\)", heading):
        return []
    return [f"the first heading is '{heading}': '{version} (YEAR-MONTH-DAY)' is due"]


def copy_tree(into: Path) -> None:
    """Copy the files that git tracks, so that nothing else gets into a package."""
    for name in _lines("git", "ls-files"):
        (into / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, into / name, follow_symlinks=False)


def build_packages(tree: Path, out: Path, *options: str) -> list[str]:
    """Build the sdist, and the wheel from it. options: of `python -m build`."""
    return _run([sys.executable, "-m", "build", "--outdir", str(out), *options, str(tree)])


def wheel_problems(wheel: Path, tree: Path) -> list[str]:
    """A wheel holds all files of the packages, the licence and the notice, and nothing else."""
    due = {str(path.relative_to(tree)) for path in (tree / "foldcell").iterdir() if path.is_file()}
    within = (path for name in PACKAGES for path in (tree / name).rglob("*") if path.is_file())
    due |= {f"foldcell/{path.relative_to(tree)}" for path in within}
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
    held = {name for name in names if ".dist-info/" not in name}
    about = {name.split(".dist-info/")[1] for name in names - held}
    problems = [f"{name} is missing" for name in sorted(due - held)]
    problems += [f"{name} is too much" for name in sorted(held - due)]
    problems += [f"{name} is missing" for name in ("licenses/LICENSE", "licenses/NOTICE") if name not in about]
    size = wheel.stat().st_size
    return problems + ([f"{size} bytes, at most {LARGEST_WHEEL} are due"] if size > LARGEST_WHEEL else [])


def try_wheel(wheel: Path, folder: Path, shared: Path | None = None) -> list[str]:
    """Install the wheel into an empty environment, use it, and remove it. Returns the problems.

    shared: a folder of installed packages that the environment takes over; then a run has to be stored in the
    logs, `folder/home/.local/share/foldcell/logs`. None: the packages are installed as pinned, and a towel is
    folded.
    """
    environment, home = folder / "environment", folder / "home"
    home.mkdir(parents=True, exist_ok=True)
    venv.create(environment)
    (site,) = environment.glob("lib/python*/site-packages")
    pip = [sys.executable, "-m", "pip", "--python", str(environment / "bin" / "python"), "--quiet"]
    if shared is not None:
        folders = [shared, *shared.glob("cmeel.prefix/lib/python*/site-packages")]
        (site / "shared.pth").write_text("".join(f"{path}\n" for path in folders))
        needed = ["--no-deps", "--no-index"]
    else:
        pins = re.findall(r"^[^ #]+==[^ ]+", (ROOT / "constraints.txt").read_text(), re.M)
        (folder / "pins.txt").write_text("\n".join(pins))
        needed = ["-c", str(folder / "pins.txt")]
    if problems := _run([*pip, "install", *needed, str(wheel)]):
        return problems
    before = _files(environment)
    problems = list(_use(environment / "bin" / "foldcell", home, folds=shared is None))
    problems += [f"a command wrote or removed {path}" for path in sorted(before ^ _files(environment))]
    stray = {path for path in _files(home) if not any(path.is_relative_to(allowed) for allowed in MAY_WRITE)}
    problems += [f"a command wrote {path} into the home folder" for path in sorted(stray)]
    problems += _run([*pip, "uninstall", "--yes", "foldcell"])
    with zipfile.ZipFile(wheel) as archive:
        brought = {name.split("/")[0] for name in archive.namelist()}
    left = [
        path for path in (environment / "bin" / "foldcell", *(site / name for name in brought)) if path.exists()
    ]
    return problems + [f"{path} is left after the removal" for path in sorted(left)]


def _use(program: Path, home: Path, folds: bool) -> Iterator[str]:
    """Call the commands as a user who has only the wheel. Yields the problems."""
    surroundings = {"HOME": str(home), "PATH": os.environ.get("PATH", os.defpath), "LANG": "C.UTF-8"}

    def call(*words: str) -> tuple[str, list[str]]:
        line = [str(program), *words]
        done = subprocess.run(line, cwd=home, env=surroundings, capture_output=True, text=True)
        failed = [f"foldcell {' '.join(words)}: exit {done.returncode}: {(done.stderr + done.stdout)[-2000:]}"]
        return done.stdout, failed if done.returncode else []

    yield from call("--help")[1]
    yield from call("doctor")[1]
    if folds:
        yield from call("fold", "small_towel")[1]
    said, failed = call("report", "last", "--json")
    yield from failed
    if folds and not failed and json.loads(said)["report"] is None:
        yield "the fold has left no report"
    line = [str(program), "dashboard", "--json"]
    with subprocess.Popen(
        line, cwd=home, env=surroundings, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        address = json.loads(process.stdout.readline() or "{}").get("address")
        if address is None:
            yield "foldcell dashboard: gives no address"
        else:
            with urllib.request.urlopen(address) as answer:
                if "towel" not in answer.read().decode():
                    yield "foldcell dashboard: the page does not show the run"
        process.terminate()


def _files(folder: Path) -> set[Path]:
    """Return all files below a folder, apart from modules that Python has compiled."""
    found = (path.relative_to(folder) for path in folder.rglob("*") if not path.is_dir())
    return {path for path in found if path.suffix != ".pyc"}


def _lines(*command: str) -> list[str]:
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()


def _run(command: Sequence[str]) -> list[str]:
    """Run a command. Returns the end of its output if it failed."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    return [f"{' '.join(command[:4])} ...: {(done.stdout + done.stderr)[-3000:]}"] if done.returncode else []


if __name__ == "__main__":
    sys.exit(main())
