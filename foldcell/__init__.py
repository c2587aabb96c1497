"""The cell from Python: fold a garment, optimise its folds, look at a picture, read a finished run.

Importing this package loads none of the cell; a function imports what it needs when it is called.

Errors are those of `robots.errors`: ConfigurationError for an argument or a file that is wrong, StorageError for a
disk that cannot be read or written. An expected failure (no garment in the picture, a fold that was not made) is
no exception: the result holds it as `failure`.
"""

from typing import TYPE_CHECKING, Any

from foldcell.folding import fold
from foldcell.optimising import OptimisedFold, optimise
from foldcell.perceiving import PerceivedGarment, perceive
from foldcell.runs import Run, load_run
from robots.errors import CellError, ConfigurationError, Failure, StorageError

if TYPE_CHECKING:
    from cell.recording.transcript.set_points import SetPoints
    from cell.states.fold_request import FoldResult

__all__ = [
    "CellError",
    "ConfigurationError",
    "Failure",
    "FoldResult",
    "OptimisedFold",
    "PerceivedGarment",
    "Run",
    "SetPoints",
    "StorageError",
    "fold",
    "load_run",
    "optimise",
    "perceive",
]


def __getattr__(name: str) -> Any:
    """The types of the cell that results are of, imported at their first use."""
    if name == "FoldResult":
        from cell.states.fold_request import FoldResult

        return FoldResult
    if name == "SetPoints":
        from cell.recording.transcript.set_points import SetPoints

        return SetPoints
    raise AttributeError(f"module 'foldcell' has no attribute '{name}'")
