"""Write the tool poses of optimised folds into a file, for another robot or program."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from foldcell.arguments import own_numeric_state
from foldcell.arguments import path as as_path

if TYPE_CHECKING:
    from foldcell.optimising import OptimisedFold

__all__ = ["export"]


@own_numeric_state
def export(folds: Sequence[OptimisedFold], file: str | Path) -> Path:
    """Write the tool poses over time of the folds, from the grasp to the release. Returns the file's path.

    The ending of the file chooses the format: `.csv`, `.json`, or `.yaml` for one
    trajectory_msgs/MultiDOFJointTrajectory of ROS per fold. Times are in seconds, positions in metres in the table
    frame, orientations are quaternions with the scalar last. Folds without arcs are left out.

    Raises ConfigurationError for another ending, StorageError if the file cannot be written.
    """
    from cell.support.files.whole_file import write_whole
    from foldcell.optimising import OptimisedFold
    from robots.errors import ConfigurationError
    from skills.trajectory.export.tool_poses import SUFFIXES, tool_poses_text

    path = as_path(file, "file")
    if not isinstance(folds, Sequence) or not all(isinstance(fold, OptimisedFold) for fold in folds):
        raise ConfigurationError(
            "folds: is no sequence of optimised folds", "give what foldcell.optimise returned"
        )
    if path.suffix not in SUFFIXES:
        raise ConfigurationError(f"file: {path}", f"a file ending in {', '.join(SUFFIXES)} is expected")
    poses = {fold.name: fold.tool_poses for fold in folds if fold.tool_poses}
    write_whole(path, tool_poses_text(folds[0].garment if folds else "", poses, path.suffix).encode())
    return path
