"""Use the cell from Python: fold a garment, optimise its folds, recognise it in a picture, read a finished run.

Importing this package loads none of the cell. Each function imports the modules that it needs when it is called.

The functions raise the errors of `robots.errors`: ConfigurationError for an invalid argument or file, StorageError
if the disk cannot be read or written. An expected failure (no garment in the picture, a fold that was not made)
raises no error: the result holds it as `failure`.
"""

from typing import TYPE_CHECKING, Any

from foldcell.exporting import export
from foldcell.folding import fold
from foldcell.garments import new_garment
from foldcell.loading import Run, load_run
from foldcell.optimising import OptimisedFold, optimise
from foldcell.perceiving import PerceivedGarment, perceive
from foldcell.robots.errors import CellError, ConfigurationError, Failure, StorageError

if TYPE_CHECKING:
    from foldcell.cell.record.run_record import FoldRecord, GraspRecord, RunRecord
    from foldcell.cell.transcript.set_points import SetPoints

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


def __getattr__(name: str) -> Any:
    """Import the cell's result types when they are first used."""
    if name in {"FoldRecord", "GraspRecord", "RunRecord"}:
        from foldcell.cell.record import run_record

        return getattr(run_record, name)
    if name == "SetPoints":
        from foldcell.cell.transcript.set_points import SetPoints

        return SetPoints
    raise AttributeError(f"module 'foldcell' has no attribute '{name}'")
