"""Keeps the picture of every question that the cell asks, in the run's folder."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from foldcell.cell.report.camera_pictures.question_picture import QUESTIONS
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.support.files.encoded_picture import jpeg_file
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.robots.errors import StorageError
from foldcell.skills.vocabulary import CameraCalibration

__all__ = ["FOLDER", "QuestionFiles"]

FOLDER = "questions"


class QuestionFiles:
    """An observer that writes `questions/NN-STATE.jpg` when the cell asks: the picture that the operator sees. A
    picture that cannot be written never ends the run."""

    def __init__(self, run_folder: Path, calibration: CameraCalibration) -> None:
        self._folder, self._nominal = run_folder / FOLDER, calibration
        self._context = RunContext()
        self._count = 0

    def entered(self, t: float, step: Step) -> None:
        frame = self._context.sight.shown
        if step.target not in QUESTIONS or frame is None:
            return
        self._count += 1
        calibration = self._context.sight.calibration(self._nominal)
        picture = QUESTIONS[step.target](frame, calibration, self._context)
        with suppress(StorageError, OSError):
            self._folder.mkdir(exist_ok=True)
            write_whole(self._folder / f"{self._count:02d}-{step.target.value}.jpg", jpeg_file(picture))

    def performed(self, t: float, step: Step, result: Result) -> None:
        self._context = result.context
