"""Keeps the picture of every question that the cell asks, in the run's folder."""

from __future__ import annotations

from pathlib import Path

from foldcell.cell.report.camera_pictures.projected_drawing import jpeg_file
from foldcell.cell.report.camera_pictures.question_picture import QUESTIONS
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.robots.errors import StorageError
from foldcell.skills.vocabulary import CameraCalibration

__all__ = ["FOLDER", "QuestionFiles"]

FOLDER = "questions"


class QuestionFiles:
    """An observer that writes `questions/NN-STATE.jpg` when the cell asks: the picture that the operator sees.

    Pictures that cannot be written are listed in `unwritten`; they never end the run.
    """

    def __init__(self, run_folder: Path, calibration: CameraCalibration) -> None:
        self._folder, self._nominal = run_folder / FOLDER, calibration
        self._context = RunContext()
        self._count = 0
        self.unwritten: list[str] = []

    def entered(self, t: float, step: Step) -> None:
        frame = self._context.sight.shown
        if step.target not in QUESTIONS or frame is None:
            return
        self._count += 1
        calibration = self._context.sight.calibration(self._nominal)
        picture = QUESTIONS[step.target](frame, calibration, self._context)
        path = self._folder / f"{self._count:02d}-{step.target.value}.jpg"
        try:
            self._folder.mkdir(exist_ok=True)
            write_whole(path, jpeg_file(picture))
        except (StorageError, OSError) as e:
            self.unwritten.append(
                e.what if isinstance(e, StorageError) else f"{path} cannot be written: {e.strerror}"
            )

    def performed(self, t: float, step: Step, result: Result) -> None:
        self._context = result.context
