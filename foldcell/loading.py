"""Read finished runs from their folder and the journal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foldcell.arguments import own_numeric_state, path
from foldcell.cell.journal.journal import Entry, Intent, Journal, performed
from foldcell.cell.record.run_record import FoldRecord, RunRecord, record_of
from foldcell.cell.support.files.paths import journal_path, logs_of_run
from foldcell.cell.transcript.set_points import SetPoints, read_grips, read_set_points
from foldcell.cell.transcript.transcript import TRANSCRIPT, Transcript
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array


@dataclass(frozen=True, eq=False)
class Run:
    """A run that has ended. Values named `..._s` are in seconds of the cell's clock, values named `..._m` in
    metres.

    status: result of the run ('folded', 'not_folded', 'fault', 'not_begun'; for a calibration 'done', 'not_done'),
    or 'interrupted' if its process ended without ending the run. seed: None on hardware without a seed. started,
    ended: wall time [s since 1970]; ended is None for an interrupted run. versions: package -> version.

    record: what `fold` returned and `fold --json` printed; None for an interrupted run or a calibration. entries:
    every line of the journal in order. effects: every effect in order, with its intent and result.
    """

    id: str
    status: str
    garment: str
    seed: int | None
    driver: str
    started: float
    ended: float | None
    versions: Mapping[str, str]
    settings_hash: str
    folder: Path
    record: RunRecord | None
    entries: tuple[Entry, ...]
    effects: tuple[Intent, ...]

    @property
    def folds(self) -> tuple[FoldRecord, ...]:
        """The planned folds; empty for a run without a record."""
        return self.record.steps if self.record else ()

    @own_numeric_state
    def set_points(self) -> SetPoints | None:
        """The set-points sent to the arms, read from the transcript; None for a run without a transcript.

        `foldcell.cell.transcript.set_points.SetPoints` documents the arrays' shapes and units. Raises
        StorageError if the transcript is damaged or of another version.
        """
        transcript = self._transcript()
        return read_set_points(transcript) if transcript else None

    @own_numeric_state
    def grips(self) -> Mapping[str, Array] | None:
        """The grip forces that the pads measured: 'left' and 'right' -> (k, 2), rows of time [s] and force [N];
        None for a run without a transcript. Raises as `set_points`."""
        transcript = self._transcript()
        return read_grips(transcript) if transcript else None

    def _transcript(self) -> Transcript | None:
        file = self.folder / TRANSCRIPT
        return Transcript(file) if file.is_file() else None

    @own_numeric_state
    def joint_trajectory(self) -> dict[str, Any] | None:
        """The set-points of the arms in the layout of a trajectory_msgs/JointTrajectory of ROS, with the joint
        names of the run's robot; None for a run without set-points. Raises as `set_points`, and
        ConfigurationError if the run's robot is no longer installed."""
        # only now, because kinematics take a second to load
        from foldcell.cell.config.cell_settings import load_settings
        from foldcell.cell.hardware.robot_model import load_robot
        from foldcell.cell.runs.request_file import SETTINGS
        from foldcell.skills.trajectory.export import joint_trajectory

        sent = self.set_points()
        if sent is None or not len(sent.t):
            return None
        names = load_robot(load_settings(self.folder / SETTINGS)).joint_names
        return joint_trajectory(names, sent.t, sent.q, sent.qd)


@own_numeric_state
def load_run(run: str | Path, logs: str | Path | None = None) -> Run:
    """Read a finished run. run: its id, the beginning of its id, its folder, or 'last'. logs: folder of the
    journal; None: the folder that holds the run's folder, else FOLDCELL_LOGS, else the default folder.

    Raises ConfigurationError if the run does not exist or has not ended, StorageError if the journal cannot be
    read.
    """
    wanted = path(run, "run")
    place = logs_of_run(wanted, None if logs is None else path(logs, "logs"))
    with Journal.open(journal_path(place), readonly=True) as journal:
        row = journal.run(str(wanted))
        if row.status == "running":
            raise ConfigurationError(f"the run {row.id} has not ended (pid {row.pid})", "try again when it has")
        entries = journal.entries(row.id)
    return Run(
        id=row.id,
        status=row.status,
        garment=row.garment,
        seed=row.seed,
        driver=row.driver,
        started=row.started,
        ended=row.ended,
        versions=row.versions,
        settings_hash=row.settings_hash,
        folder=row.directory,
        record=record_of(row.summary),
        entries=tuple(entries),
        effects=tuple(performed(entries)),
    )
