"""The frame store keeps each picture once, bit for bit, and reports damaged ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from foldcell.cell.journal.frame_store import FrameStore
from foldcell.cell.journal.run_checkpoint import write_checkpoint
from foldcell.cell.states.run_context import RunContext
from foldcell.robots.errors import StorageError
from foldcell.robots.ports import CameraFrame, Intrinsics


def picture(seed: int, stamp: float = 1.25) -> CameraFrame:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 1.5, (48, 64)).astype(np.float32)
    depth[rng.random((48, 64)) < 0.1] = np.nan
    rgb = rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)
    return CameraFrame(stamp, seed, rgb, depth, Intrinsics(64, 48, 60.1, 60.2, 31.5, 23.5))


def test_a_picture_comes_back_bit_for_bit(tmp_path: Path) -> None:
    frame = picture(1)
    name = FrameStore(tmp_path / "frames").put(frame)
    back = FrameStore(tmp_path / "frames").get(name)
    assert back.rgb.tobytes() == frame.rgb.tobytes() and back.rgb.dtype == frame.rgb.dtype
    assert back.depth.tobytes() == frame.depth.tobytes() and back.depth.dtype == frame.depth.dtype
    assert (back.stamp, back.sequence) == (frame.stamp, frame.sequence)
    assert vars(back.intrinsics) == vars(frame.intrinsics)
    assert not back.rgb.flags.writeable and not back.depth.flags.writeable


def test_equal_pictures_are_stored_once_and_different_ones_separately(tmp_path: Path) -> None:
    store = FrameStore(tmp_path / "frames")
    names = [store.put(p) for p in (picture(1), picture(1), picture(2), picture(1, stamp=1.5))]
    assert names[0] == names[1] and len(set(names)) == 3
    assert len(list((tmp_path / "frames").iterdir())) == 3


def test_a_runs_folder_that_vanished_is_not_made_again(tmp_path: Path) -> None:
    """The run ends instead: a journal without its run's files is of no use."""
    run = tmp_path / "run"
    with pytest.raises(StorageError, match="cannot be created"):
        FrameStore(run / "frames").put(picture(1))
    with pytest.raises(StorageError, match="cannot be created"):
        write_checkpoint(run / "checkpoint", RunContext(), FrameStore(run / "frames"))
    assert not run.exists()


def test_a_changed_byte_of_a_picture_is_detected_or_harmless(tmp_path: Path) -> None:
    """For damage at any place of the file, the store returns the original picture or raises an error."""
    store = FrameStore(tmp_path)
    frame = picture(1)
    name = store.put(frame)
    path = tmp_path / f"{name}.npz"
    content = path.read_bytes()
    told = 0
    for at in range(0, len(content), 61):
        path.write_bytes(content[:at] + bytes([content[at] ^ 0xFF]) + content[at + 1 :])
        try:
            assert FrameStore(tmp_path).get(name).rgb.tobytes() == frame.rgb.tobytes()
        except StorageError:
            told += 1
    assert told > 0.9 * len(range(0, len(content), 61))


def test_a_picture_under_a_wrong_name_is_a_storage_error(tmp_path: Path) -> None:
    store = FrameStore(tmp_path)
    one, other = store.put(picture(1)), store.put(picture(2))
    (tmp_path / f"{one}.npz").write_bytes((tmp_path / f"{other}.npz").read_bytes())
    with pytest.raises(StorageError, match="missing or damaged"):
        FrameStore(tmp_path).get(one)


def test_a_missing_or_truncated_picture_is_a_storage_error(tmp_path: Path) -> None:
    store = FrameStore(tmp_path)
    name = store.put(picture(1))
    path = tmp_path / f"{name}.npz"
    path.write_bytes(path.read_bytes()[:300])
    for wanted in (name, "0" * 64):
        with pytest.raises(StorageError, match="missing or damaged"):
            FrameStore(tmp_path).get(wanted)


class Executed:
    """An object whose pickle, when it is read, creates a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[Path], None], tuple[Path]]:
        return Path.touch, (self.path,)


def test_code_in_a_picture_file_is_not_executed(tmp_path: Path) -> None:
    """Whoever replays a run may have got its folder from somebody else."""
    store, executed = FrameStore(tmp_path), tmp_path / "executed"
    path = tmp_path / f"{store.put(picture(1))}.npz"
    np.savez(path, plain=np.array([Executed(executed)], dtype=object))
    with pytest.raises(StorageError, match="missing or damaged"):
        FrameStore(tmp_path).get(path.stem)
    assert not executed.exists()
