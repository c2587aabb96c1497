"""Imports only go down, and no text names a path outside the repository."""

import re
import subprocess
import sys
from pathlib import Path

from tests.optional_parts import GIT

ROOT = Path(__file__).resolve().parents[2]


def lint_imports(config: Path | None = None, cwd: Path = ROOT) -> subprocess.CompletedProcess:
    """Run the import check: of the repository with the cache that `make lint` filled, or with a configuration."""
    command = [str(Path(sys.executable).parent / "lint-imports")]
    command += ["--no-cache", "--config", str(config)] if config else []
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True)


def test_imports_only_go_down_and_have_no_cycle() -> None:
    answer = lint_imports()
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert "6 kept, 0 broken" in answer.stdout


def checked_tree(folder: Path, files: dict[str, str], contract: str) -> subprocess.CompletedProcess:
    """Run the import check on a small package tree with the same layers."""
    for layer in ("cell", "calibration", "skills", "robots"):
        (folder / layer).mkdir()
        (folder / layer / "__init__.py").write_text("")
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        ((folder / name).parent / "__init__.py").write_text("")
        (folder / name).write_text(text)
    (folder / "lint.toml").write_text(
        "[tool.importlinter]\n"
        'root_packages = ["cell", "calibration", "skills", "robots"]\n'
        f"[[tool.importlinter.contracts]]\n{contract}"
    )
    return lint_imports(folder / "lint.toml", folder)


def test_the_check_finds_an_upward_import(tmp_path: Path) -> None:
    """This shows that the check can fail."""
    layers = 'name = "layers"\ntype = "layers"\nlayers = ["cell", "calibration", "skills", "robots"]\n'
    answer = checked_tree(
        tmp_path, {"skills/grasp.py": "import cell.executive.runner\n", "cell/executive/runner.py": ""}, layers
    )
    assert answer.returncode == 1
    assert "skills.grasp -> cell.executive.runner" in answer.stdout


def test_the_check_finds_a_cycle_between_packages(tmp_path: Path) -> None:
    """No module imports itself, directly or indirectly, but the packages import each other."""
    files = {
        "cell/motion/path.py": "import cell.storage.file\n", "cell/motion/clock.py": "",
        "cell/storage/file.py": "", "cell/storage/times.py": "import cell.motion.clock\n",
    }  # fmt: skip
    answer = checked_tree(tmp_path, files, 'name = "no circle"\ntype = "acyclic_siblings"\nancestors = ["cell"]\n')
    assert answer.returncode == 1
    assert "motion" in answer.stdout and "storage" in answer.stdout


def tracked_texts() -> list[Path]:
    """The files of the repository: those that git tracks or would add."""
    GIT.require()
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return [ROOT / name for name in answer.stdout.split("\0") if name and (ROOT / name).is_file()]


def foreign_paths() -> tuple[str, ...]:
    # assembled here, so that this file does not match itself
    places = (("work", "main"), ("work", "shared"), ("work", ".library"), ("tmp", "contracts"))
    return tuple(f"/{a}/{b}" for a, b in places)


def test_no_text_names_a_path_outside_the_repository() -> None:
    found = []
    for path in tracked_texts():
        data = path.read_bytes()
        if b"\0" in data:
            continue
        text = data.decode("utf-8")
        found += [f"{path.relative_to(ROOT)}: {place}" for place in foreign_paths() if place in text]
    assert found == []


def test_constraints_pin_versions_and_hashes_without_urls_or_paths() -> None:
    text = (ROOT / "constraints.txt").read_text()
    assert "/" not in text and "@" not in text
    for entry in text.replace("\\\n", " ").splitlines():
        pin, *hashes = entry.split()
        name, _, version = pin.partition("==")
        assert name and version[0].isdigit(), entry
        assert hashes and all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", h) for h in hashes), pin


def test_every_package_is_marked_as_typed() -> None:
    for layer in ("foldcell", "cell", "calibration", "skills", "robots"):
        assert (ROOT / layer / "py.typed").is_file()
