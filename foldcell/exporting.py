"""Write the tool poses of optimised folds into a file, for another robot or program."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from foldcell.arguments import own_numeric_state
from foldcell.arguments import path as as_path
from foldcell.cell.support.files.whole_file import refuse_foreign, write_whole
from foldcell.optimising import OptimisedFold
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.trajectory.export import MARKS, tool_poses_text


@own_numeric_state
def export(folds: Sequence[OptimisedFold], file: str | Path) -> Path:
    """Write the tool poses over time of the folds, from the grasp to the release. Returns the file's path.

    The ending of the file chooses the format: `.csv`, `.json`, or `.yaml` for one
    trajectory_msgs/MultiDOFJointTrajectory of ROS per fold. Times are in seconds, positions in metres in the table
    frame, orientations are quaternions with the scalar last. Folds without arcs are left out.

    Raises ConfigurationError for another ending, for folds of several garments, for two folds of one name, if no
    fold has an arc, and if a file exists that is no export; StorageError if the file cannot be written.
    """
    path = as_path(file, "file")
    if not isinstance(folds, Sequence) or not all(isinstance(fold, OptimisedFold) for fold in folds):
        raise ConfigurationError(
            "folds: is no sequence of optimised folds", "give what foldcell.optimise returned"
        )
    if path.suffix not in MARKS:
        raise ConfigurationError(f"file: {path}", f"a file ending in {', '.join(MARKS)} is expected")
    garments = list(dict.fromkeys(fold.garment for fold in folds))
    if len(garments) > 1:
        hint = "a file holds the folds of one garment; export each garment into a file of its own"
        raise ConfigurationError(f"folds: they are of {', '.join(garments)}", hint)
    made = [fold for fold in folds if fold.tool_poses]
    if not made:
        reasons = "; ".join(f"{fold.name}: {fold.failure.what}" for fold in folds if fold.failure)
        raise ConfigurationError("folds: none has an arc, so that there is nothing to export", reasons)
    poses = {fold.name: fold.tool_poses for fold in made}
    if len(poses) < len(made):
        hint = "a file holds each fold once; export what was optimised in two ways into two files"
        raise ConfigurationError(f"folds: {', '.join(fold.name for fold in made)}: one is there twice", hint)
    refuse_foreign(path, MARKS[path.suffix])
    write_whole(path, tool_poses_text(garments[0], poses, path.suffix).encode())
    return path
