"""A workcell around the fake ports, for tests of the runner and of single effects without a robot's model."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from foldcell.cell.config.cell_settings import CellSettings, load_settings
from foldcell.cell.hardware.assembly import execution_limits
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.view.recorder import Recorder
from foldcell.skills.trajectory.trajectory_library import Library
from tests.fakes import FakeCell


@cache
def _shipped() -> CellSettings:
    return load_settings()


class ImmediateExecutor(ThreadPoolExecutor):
    """Computes in the caller's thread: `submit` returns a future that is already done."""

    def __init__(self) -> None: ...

    def submit(self, work: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        done: Future[Any] = Future()
        try:
            done.set_result(work(*args, **kwargs))
        except Exception as error:
            done.set_exception(error)
        return done


def fake_workcell(cell: FakeCell, workers: ThreadPoolExecutor | None = None, **changes: Any) -> Workcell:
    """A workcell with the shipped settings, no recording, and a robot that is parked at its zero configuration.

    Without `workers` a skill computes in the caller's thread.
    """
    settings = changes.pop("settings", None) or _shipped()
    fields: dict[str, Any] = {
        "ports": cell.ports(),
        "settings": settings,
        "table": settings.table,
        "calibration": camera_calibration(settings),
        "robot": SimpleNamespace(q_park=np.zeros(14), protective=None),
        "checker": SimpleNamespace(contact=lambda q: None),
        "execution_checker": None,
        "limits": None,
        "execution": execution_limits(settings.motion),
        "garments": (),
        "expected": None,
        "grasp": settings.grasp.settings(contact_effort=9.0, empty_opening=0.0, tip_distance=0.038),
        "perception": settings.perception.settings(),
        "inspection": settings.inspection.settings(settings.perception),
        "library": Library,
        "ideal_heights": lambda garment: (),
        "keep": lambda *_: None,
        "recorder": Recorder.silent(),
        "commands": CommandQueue(),
        "workers": workers or ImmediateExecutor(),
        "attended": False,
        "approve": False,
        "tell": lambda text: None,
        "progress": lambda *_: None,
        "rng": lambda: np.random.default_rng(1),
    }
    return Workcell(**{**fields, **changes})
