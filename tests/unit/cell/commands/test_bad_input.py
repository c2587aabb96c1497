"""Bad input through the real commands: exit code 64, a helpful message, and no byte written.

test_cell_settings.py and test_garment_file.py test what each reader refuses. These tests check that a command
stops before it writes.
"""

from __future__ import annotations

import argparse
import errno
import json
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from foldcell.cell.commands.exit_codes import framed
from foldcell.cell.commands.main import main
from foldcell.cell.config.calibration_file import calibration_text
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import shipped_garment_path
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.journal.journal import Journal
from foldcell.cell.support.files import picture_file
from foldcell.cell.support.process.lock import OwnerLock
from tests.builders.yaml_texts import aliases_of_aliases


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's current folder. The logs folder does not exist yet."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FOLDCELL_LOGS", str(tmp_path / "logs"))
    return tmp_path


@pytest.fixture
def refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command line that must be refused, and returns its message."""

    def run(line: str, *parts: str) -> str:
        before = contents(folder)
        assert main(line.split()) == 64
        captured = capsys.readouterr()
        assert "Traceback" not in captured.err + captured.out
        assert captured.err.startswith("foldcell: ")
        for part in parts:
            assert part in captured.err
        assert contents(folder) == before, "nothing was written"
        if "--json" in line:
            answer = json.loads(captured.out.rstrip("\n").split("\n")[-1])
            assert answer["exit_code"] == 64 and answer["error"] in captured.err
        return captured.err

    return run


def contents(folder: Path) -> dict[str, Any]:
    """All names below a folder, and the time and bytes of each file."""
    return {
        str(p.relative_to(folder)): (p.stat().st_mtime_ns, p.read_bytes()) if p.is_file() else None
        for p in sorted(folder.rglob("*"))
    }


@pytest.mark.parametrize(
    "line",
    [
        "hil NAME",
        "calibrate tactile --output NAME",
        "tidy --logs NAME --json",
        "compare NAME last",
        "perceive NAME",
    ],
)
def test_a_name_that_no_file_can_have_is_refused(refused: Callable[..., str], line: str) -> None:
    refused(line.replace("NAME", 300 * "a"), "File name too long")


@pytest.mark.parametrize("line", ["runs", "runs --json", "tidy", "tidy --yes", "report last"])
def test_a_file_is_no_logs_folder(refused: Callable[..., str], folder: Path, line: str) -> None:
    (folder / "notes.txt").write_text("x")
    refused(f"{line} --logs notes.txt", "notes.txt")


@pytest.mark.parametrize("line", ["garment show", "cell check --cell", "fold", "hil", "trials"])
@pytest.mark.timeout(60)
def test_a_file_without_an_end_is_refused(refused: Callable[..., str], line: str) -> None:
    refused(f"{line} /dev/full", "/dev/full", "has no end")


def test_a_folder_that_may_not_be_searched_is_no_bug(capsys: pytest.CaptureFixture[str]) -> None:
    def ask(options: argparse.Namespace) -> int:  # as Path.is_file does
        raise PermissionError(errno.EACCES, "Permission denied", "/root/mine.yaml")

    assert framed(lambda: argparse.Namespace(run=ask), False) == 64
    assert capsys.readouterr().err.startswith("foldcell: /root/mine.yaml cannot be used: Permission denied")


@pytest.mark.parametrize("place", [".", "/", ""])
@pytest.mark.parametrize("command", ["perceive", "perceive --unit px"])
def test_a_folder_is_no_picture(
    folder: Path, command: str, place: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command.split(), place]) == 64
    assert "is a folder" in capsys.readouterr().err and contents(folder) == {}


@pytest.mark.parametrize("command", ["runs", "report last", "resume last", "replay last", "compare last last"])
@pytest.mark.parametrize(
    "change",
    [
        "UPDATE runs SET garment = CAST(x'4a86' AS TEXT)",
        "UPDATE runs SET summary = '{', versions = '['",
        "UPDATE events SET payload = '{\"a\": '",
    ],
)
def test_a_journal_with_damaged_texts_is_no_bug(
    folder: Path, command: str, change: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "logs").mkdir()
    with Journal.open(folder / "logs" / "journal.db") as journal:
        run = journal.begin_run(garment="small_towel", seed=1, driver="sim")
        run.result(run.intent(0.0, "looking", "look"), 1.0, {"event": "done"})
        run.end("not_folded", {"a": 1})
    with sqlite3.connect(folder / "logs" / "journal.db") as connection:
        connection.execute(change)
    code = main(command.split())
    assert code in (0, 2, 64) and "bug" not in capsys.readouterr().err
    assert not list(folder.rglob("crash-*"))


# garments


@pytest.mark.parametrize(
    "command", ["fold", "fold --json", "supervise", "optimise", "garment show", "library build"]
)
def test_an_unknown_garment_is_refused(refused: Callable[..., str], command: str) -> None:
    name, *options = command.split(" --")
    refused(" ".join([name, "medium_towl", *(f"--{o}" for o in options)]), "medium_towl", "medium_towel")


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        ({"colour": "red"}, ["unknown key", "colour", "known here"]),
        ({"titel": "A towel"}, ["titel", "'title'"]),
        ({"layers": 0}, ["layers", "0"]),
        ({"max_tool_speed": 350}, ["max_tool_speed", "350", "[m/s]"]),
        ({"keypoints": {"near_right": [-150, -210], "far_right": [150, -210]}}, ["keypoints", "150", "[m]"]),
    ],
)
def test_an_invalid_garment_file_is_refused(
    refused: Callable[..., str], folder: Path, change: dict[str, Any], parts: list[str]
) -> None:
    garment = yaml.safe_load(shipped_garment_path("small_towel").read_text(encoding="utf-8")) | change
    (folder / "mine.yaml").write_text(yaml.safe_dump(garment), encoding="utf-8")
    refused("fold mine.yaml --seed 1", "mine.yaml", *parts)


@pytest.mark.parametrize(
    "text",
    [
        "title: 2020-99-99",
        "title: " + "[" * 5000,
        "layers: " + "9" * 5000,
        "title: a\ntitle: b",
        "- a\n- b",
        "\0",
        aliases_of_aliases(),
        aliases_of_aliases("group"),
    ],
    ids=[
        "a date that is none",
        "nested",
        "a number without end",
        "a key twice",
        "a list",
        "no text",
        "aliases of aliases",
        "aliases of groups",
    ],
)
@pytest.mark.parametrize("command", ["fold mine.yaml", "calibrate friction mine.yaml --height 0.3 --length 1"])
def test_a_garment_file_with_bad_yaml_is_refused(
    refused: Callable[..., str], folder: Path, command: str, text: str
) -> None:
    (folder / "mine.yaml").write_text(text)
    refused(command, "mine.yaml")


@pytest.mark.parametrize("name", ["./nofile.yaml", "./folder.yaml", "./odd.yaml"])
def test_measuring_an_invalid_garment_file_is_refused(
    refused: Callable[..., str], folder: Path, name: str
) -> None:
    (folder / "folder.yaml").mkdir()
    (folder / "odd.yaml").write_text("material: {friction_angle_deg: [1, 2]}")
    refused(f"calibrate friction {name} --height 0.3 --length 0.8", name.removeprefix("./"))


@pytest.mark.parametrize(
    "files",
    ["--depth depth.png --reference empty.png", "--reference-depth depth.png"],
)
@pytest.mark.parametrize("command", ["perceive picture.png", "garment new picture.png --like small_towel"])
def test_an_incomplete_picture_of_the_empty_table_is_refused(
    refused: Callable[..., str], folder: Path, command: str, files: str
) -> None:
    for name, picture in (("picture", (480, 640, 3)), ("empty", (480, 640, 3)), ("depth", (480, 640))):
        kind = np.uint8 if len(picture) == 3 else np.uint16
        cv2.imwrite(f"{name}.png", np.full(picture, 128, kind))
    refused(f"{command} --unit m {files}", "--reference-depth")


@pytest.mark.parametrize("kind", ["empty", "several arrays", "text", "a size beyond its data"])
def test_a_depth_file_without_an_array_is_refused(refused: Callable[..., str], folder: Path, kind: str) -> None:
    cv2.imwrite("picture.png", np.full((480, 640, 3), 128, np.uint8))
    with Path("depth.npy").open("wb") as file:
        if kind == "several arrays":
            np.savez(file, a=np.zeros(3), b=np.zeros(3))
        elif kind == "text":
            file.write(b"not an array")
        elif kind == "a size beyond its data":  # more than any memory holds
            stated = {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**6)}
            np.lib.format.write_array_header_1_0(file, stated)  # type: ignore[no-untyped-call]
    refused("perceive picture.png --unit m --depth depth.npy", "depth.npy", "array")


def test_a_depth_image_of_more_pixels_than_a_camera_has_is_refused(
    refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture_file, "LARGEST_PICTURE", 640 * 480)
    cv2.imwrite("picture.png", np.full((480, 640, 3), 128, np.uint8))
    np.save("depth.npy", np.ones((481, 640), np.float32))
    refused("perceive picture.png --unit m --depth depth.npy", "depth.npy", "0 million pixels")


@pytest.mark.parametrize("kind", ["png", "jpg"])
def test_a_picture_that_states_too_many_pixels_is_not_decoded(refused: Callable[..., str], kind: str) -> None:
    done, data = cv2.imencode(f".{kind}", np.full((480, 640, 3), 128, np.uint8))
    wide, high = (640).to_bytes(2, "big"), (480).to_bytes(2, "big")
    stated = data.tobytes().replace(b"\0\0" + wide + b"\0\0" + high, 2 * (2**17).to_bytes(4, "big"), 1)
    stated = stated.replace(high + wide, 2 * (30_000).to_bytes(2, "big"), 1)
    assert done and stated != data.tobytes()
    Path(f"picture.{kind}").write_bytes(stated)
    refused(f"perceive picture.{kind} --unit px", f"picture.{kind}", "million pixels", "at most 268")


@pytest.mark.parametrize("size", [(8, 48), (48, 8)])
def test_a_photograph_that_is_a_strip_is_refused(refused: Callable[..., str], size: tuple[int, int]) -> None:
    """The view of the table that it would show needs more memory, the longer it is."""
    cv2.imwrite("strip.png", np.full((*size, 3), 128, np.uint8))
    refused("perceive strip.png --unit px", f"{size[1]} x {size[0]} pixels", "crop it")


def test_an_unmeasured_surface_is_refused(refused: Callable[..., str], folder: Path) -> None:
    (folder / "cell.yaml").write_text("surface: ice\n")
    message = refused("fold small_towel --cell cell.yaml", "ice", "bare_table")
    assert "surface" in message


# settings


SETTINGS = [
    ("tabel: {height: 0}", ["cell.yaml:1", "unknown key 'tabel'", "did you mean 'table'"]),
    ("grasp:\n  grip_froce: 10", ["cell.yaml:2", "unknown key 'grasp.grip_froce'", "'grip_force'"]),
    ("table:\n  height: -100", ["cell.yaml:2", "table.height", "-0.6 to 0.5 m", "millimetres", "-0.1"]),
    ("motion: {approach_height: 100}", ["motion.approach_height", "millimetres", "0.1"]),
    ("recovery: {attempts_per_step: -1}", ["recovery.attempts_per_step", "0 to 20"]),
    (aliases_of_aliases(), ["cell.yaml:5", "more than", "write the values out"]),
    ("camera: {calibration: none.yaml}", ["cell.yaml:1", "camera.calibration", "none.yaml"]),
]


@pytest.mark.parametrize(("text", "parts"), SETTINGS)
def test_invalid_settings_are_refused(
    refused: Callable[..., str], folder: Path, text: str, parts: list[str]
) -> None:
    (folder / "cell.yaml").write_text(text)
    refused("fold small_towel --cell cell.yaml --json", *parts)


@pytest.mark.parametrize(
    "line",
    ["supervise small_towel", "trials --garments small_towel --n 1", "optimise small_towel --export out.csv",
     "library build small_towel", "library show", "perceive picture.png"],
)  # fmt: skip
def test_every_command_with_settings_refuses_invalid_ones(
    refused: Callable[..., str], folder: Path, line: str
) -> None:
    (folder / "cell.yaml").write_text("table: {height: 820}")
    (folder / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    refused(f"{line} --cell cell.yaml", "table.height", "millimetres")


@pytest.mark.parametrize("line", ["fold small_towel --cell none.yaml", "fold small_towel --cell ."])
def test_unreadable_settings_are_refused(refused: Callable[..., str], line: str) -> None:
    refused(line)


def truncated(text: str) -> bytes:
    return text[: len(text) // 2].encode()


def in_millimetres(text: str) -> bytes:
    data = yaml.safe_load(text)
    for row in data["T_table_camera"][:3]:
        row[3] *= 1000
    return yaml.safe_dump(data).encode()


@pytest.mark.parametrize("spoil", [truncated, in_millimetres, lambda _: b"\x89PNG\xff\x00", lambda _: b"", None])
def test_an_unusable_calibration_is_refused(
    refused: Callable[..., str], folder: Path, spoil: Callable[[str], bytes] | None
) -> None:
    """The message names the settings file and line, the key, and the calibration file."""
    (folder / "cell.yaml").write_text("# mine\ncamera:\n  calibration: camera.yaml\n")
    if spoil is None:
        (folder / "camera.yaml").mkdir()
    else:
        text = calibration_text(camera_calibration(load_settings()))
        (folder / "camera.yaml").write_bytes(spoil(text))
    refused("fold small_towel --cell cell.yaml --json", "cell.yaml:3", "camera.calibration", "camera.yaml")


# logs


@pytest.mark.parametrize("logs", ["a_file", "a_file/logs", "/proc/logs", "/proc/1/task/logs"])
def test_unwritable_logs_are_refused(refused: Callable[..., str], folder: Path, logs: str) -> None:
    """This also holds for root, who ignores permissions."""
    (folder / "a_file").write_text("in the way")
    refused(f"fold small_towel --logs {logs}", logs, "--logs DIR")


def test_unwritable_logs_named_by_the_environment_are_refused(
    refused: Callable[..., str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "a_file").write_text("in the way")
    monkeypatch.setenv("FOLDCELL_LOGS", str(folder / "a_file" / "logs"))
    refused("fold small_towel --json", "a_file", "FOLDCELL_LOGS")


def test_a_cell_in_use_is_refused(refused: Callable[..., str], folder: Path) -> None:
    (folder / "logs").mkdir()
    with OwnerLock(folder / "logs" / "cell.lock") as owner:
        refused("fold small_towel", "in use by process", str(owner.path))


@pytest.mark.parametrize("kind", ["text", "another program's"])
def test_a_foreign_journal_is_left_unchanged(folder: Path, capsys: pytest.CaptureFixture[str], kind: str) -> None:
    journal_file = folder / "logs" / "journal.db"
    journal_file.parent.mkdir()
    if kind == "text":
        journal_file.write_text("shopping list: " + "milk, " * 200)
    else:
        with sqlite3.connect(journal_file) as other:
            other.execute("CREATE TABLE recipes (name TEXT)")
        other.close()
    before = journal_file.read_bytes()
    assert main(["fold", "small_towel"]) == 64
    assert str(journal_file) in capsys.readouterr().err
    assert journal_file.read_bytes() == before
    assert {p.name for p in journal_file.parent.iterdir()} <= {"journal.db", "cell.lock"}
