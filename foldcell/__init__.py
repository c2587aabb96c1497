"""Use the cell from Python: fold a garment, optimise its folds, recognise it in a picture, read a finished run.

Importing this package loads none of the cell. Each name loads the modules that it needs when it is first used.

The functions raise the errors of `robots.errors`: ConfigurationError for an invalid argument or file, StorageError
if the disk cannot be read or written. An expected failure (no garment in the picture, a fold that was not made)
raises no error: the result holds it as `failure`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from foldcell.arguments import own_numeric_state
from foldcell.robots.errors import CellError, ConfigurationError, Failure, StorageError

if TYPE_CHECKING:
    from foldcell.cell.record.run_record import FoldRecord, GraspRecord, RunRecord
    from foldcell.cell.transcript.set_points import SetPoints
    from foldcell.exporting import export
    from foldcell.folding import fold
    from foldcell.garments import new_garment
    from foldcell.loading import Run, load_run
    from foldcell.optimising import OptimisedFold, optimise
    from foldcell.perceiving import PerceivedGarment, perceive

__all__ = [
    "CellError",
    "ConfigurationError",
    "Failure",
    "FoldRecord",
    "GraspRecord",
    "OptimisedFold",
    "PerceivedGarment",
    "Run",
    "RunRecord",
    "SetPoints",
    "StorageError",
    "export",
    "fold",
    "load_run",
    "new_garment",
    "optimise",
    "perceive",
]


_HOMES = {
    "FoldRecord": "cell.record.run_record",
    "GraspRecord": "cell.record.run_record",
    "OptimisedFold": "optimising",
    "PerceivedGarment": "perceiving",
    "Run": "loading",
    "RunRecord": "cell.record.run_record",
    "SetPoints": "cell.transcript.set_points",
    "export": "exporting",
    "fold": "folding",
    "load_run": "loading",
    "new_garment": "garments",
    "optimise": "optimising",
    "perceive": "perceiving",
}
"""Public name -> its module, which is imported when the name is first used."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'foldcell' has no attribute '{name}'")
    return getattr(own_numeric_state(import_module)(f"foldcell.{_HOMES[name]}"), name)
