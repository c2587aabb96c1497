"""A checkpoint restores a run's context; damaged, foreign and other versions are refused."""

from __future__ import annotations

import json
import os
import pickle
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.journal import run_checkpoint
from foldcell.cell.journal.frame_store import FrameStore
from foldcell.cell.journal.run_checkpoint import read_checkpoint, write_checkpoint
from foldcell.cell.states.recovery_table import Adjustment
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.stages import FirstLook
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import CellError, ConfigurationError, Failure, FailureKind, StorageError
from foldcell.robots.ports import CameraFrame, Intrinsics, Side
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.perception.inspection.height_expectation import CameraBias
from foldcell.skills.vocabulary import GraspId
from tests.builders.contexts import context_with

SQUARE = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.0, 0.3]])


def picture(n: int) -> CameraFrame:
    rng = np.random.default_rng(n)
    rgb = rng.integers(0, 256, (240, 320, 3), dtype=np.uint8)
    return CameraFrame(
        0.5 * n, n, rgb, rng.random((240, 320), np.float32), Intrinsics(320, 240, 9.0, 9.0, 1.0, 2.0)
    )


def context() -> RunContext:
    mesh = mesh_from_contour(SQUARE, 0.02, layers=2)
    return context_with(
        reference=picture(1),
        frame=picture(2),
        previous=picture(1),
        overlay=picture(3).rgb,
        garment=load_garment("small_towel"),
        mesh=mesh,
        vertices=mesh.lay_flat(0.002),
        index=1,
        adjustments=(Adjustment.LOWER,),
        attempts={(0, "drift"): 2},
        biases={Side.LEFT: TactileBias(0.5, np.ones((2, 4, 3)), np.zeros(2), 0.01)},
        failure=Failure(FailureKind.DRIFT, "it moved", "look", {"drift_m": 0.03}),
        reentry=Event.LOOK_AGAIN,
        first_look=FirstLook(SQUARE, CameraBias(0.002, 0.0001, True)),
    )


def same(a: Any, b: Any) -> bool:
    """Whether two values have equal types and values, with arrays and pictures equal bit for bit."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, float):
        return struct.pack("d", a) == struct.pack("d", b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if hasattr(a, "__dict__") and not isinstance(a, Event | FailureKind | Adjustment):
        return same(a.__dict__, b.__dict__)
    return bool(a == b)


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    write_checkpoint(tmp_path / "checkpoint", context(), FrameStore(tmp_path / "frames"))
    return tmp_path / "checkpoint"


def read(folder: Path) -> RunContext:
    return read_checkpoint(folder, FrameStore(folder.parent / "frames"))


def test_a_checkpoint_restores_the_context(kept: Path) -> None:
    assert same(read(kept), context())
    assert not same(read(kept), context_with(context(), index=0))


def test_a_checkpoint_from_a_python_that_pickles_enum_members_by_name_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python 3.11.2, Debian's version, pickles an Enum member as getattr(kind, name)."""
    for kind in (Event, FailureKind, Adjustment, Side, GraspId):
        monkeypatch.setattr(kind, "__reduce_ex__", lambda self, _: (getattr, (type(self), self.name)))
    assert pickle.dumps(Event.START).find(b"getattr") > 0
    write_checkpoint(tmp_path / "checkpoint", context(), FrameStore(tmp_path / "frames"))
    assert same(read(tmp_path / "checkpoint"), context())


def test_unchanged_pictures_and_arrays_are_not_written_again(kept: Path) -> None:
    """The next checkpoint does not write pictures and large arrays of the previous one again."""
    before = {p.name: p.stat().st_mtime_ns for p in (*kept.iterdir(), *(kept.parent / "frames").iterdir())}
    write_checkpoint(kept, context_with(read(kept), index=0), FrameStore(kept.parent / "frames"))
    after = {p.name: p.stat().st_mtime_ns for p in (*kept.iterdir(), *(kept.parent / "frames").iterdir())}
    assert before.keys() == after.keys() and len(after) > 3
    assert {name for name in after if after[name] != before[name]} == {"context"}
    assert read(kept).fold.index == 0


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.999])
def test_a_truncated_checkpoint_is_refused(kept: Path, share: float) -> None:
    content = (kept / "context").read_bytes()
    (kept / "context").write_bytes(content[: int(share * len(content))])
    with pytest.raises(StorageError, match="missing or damaged"):
        read(kept)


@pytest.mark.parametrize("pattern", ["checkpoint/*.npy", "frames/*.npz"])
@pytest.mark.parametrize("damage", ["gone", "cut", "altered"])
def test_a_damaged_array_or_picture_is_refused(kept: Path, pattern: str, damage: str) -> None:
    path = max(kept.parent.glob(pattern), key=lambda p: p.stat().st_size)
    content = bytearray(path.read_bytes())
    path.unlink()
    if damage == "cut":
        path.write_bytes(content[:200])
    elif damage == "altered":
        content[len(content) // 2] ^= 0xFF
        path.write_bytes(content)
    with pytest.raises(StorageError, match="missing or damaged"):
        read(kept)


OTHER_FIELDS = {"foldcell.cell.states.run_context.RunContext": ["fold"]}


@pytest.mark.parametrize(
    "change", [{"foldcell": "0.0.1"}, {"schema": 1}, {"fields": OTHER_FIELDS}, {"fields": {"cell.gone.Kind": []}}]
)
def test_a_checkpoint_of_another_version_is_refused(kept: Path, change: dict[str, Any]) -> None:
    head, _, body = (kept / "context").read_bytes().partition(b"\n")
    assert "foldcell.cell.states.run_context.RunContext" in json.loads(head)["fields"]
    (kept / "context").write_bytes(json.dumps(json.loads(head) | change).encode() + b"\n" + body)
    version = change.get("foldcell", r"\d")
    with pytest.raises(ConfigurationError, match=rf"written by another foldcell \(version {version}"):
        read(kept)


class Harm:
    def __reduce__(self) -> Any:
        return os.system, ("touch harmed",)


NOT_OURS = b"cother_package\nValue\n."
"""A pickle that names a type of another package."""


@pytest.mark.parametrize("body", [*map(pickle.dumps, [Harm(), ["a list"], np.zeros(3)]), NOT_OURS])
def test_a_checkpoint_with_other_objects_is_refused_without_executing_them(
    kept: Path, body: bytes, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "other_package.py").write_text("open('harmed', 'w').close()\nclass Value: ...\n")
    head = json.loads((kept / "context").read_bytes().partition(b"\n")[0]) | {"sha256": run_checkpoint._hash(body)}
    (kept / "context").write_bytes(json.dumps(head).encode() + b"\n" + body)
    with pytest.raises(CellError, match="missing or damaged"):
        read(kept)
    assert not (tmp_path / "harmed").exists()
