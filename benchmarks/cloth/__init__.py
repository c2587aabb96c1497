"""Figures of the cloth solver, alone on one core: foldcell bench cloth.

Speeds are simulated seconds over CPU seconds of the thread that computes (`time.thread_time`), so that what else
runs on the machine matters little; two_threads_x_throughput is wall time and wants an idle machine. Errors are
against closed forms (block on a slope, hung strip, Peirce's cantilever) or, with peers, against MuJoCo's flex.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarks.cloth import folds, physics
from robots.errors import ConfigurationError

__all__ = ["measure"]

PEER_FIGURE = "mujoco_final_error_difference_mm"


def measure(tell: Callable[[str], None], *, peers: bool, quick: bool) -> dict[str, Any]:
    """Flat figures, units in the keys; those of MuJoCo only with `peers`, PEER_FIGURE then null.

    Raises ConfigurationError when peers are asked for and MuJoCo is not installed.
    """
    figures: dict[str, Any] = {}
    peer = _mujoco() if peers else None
    folds.measure(figures, quick, tell)
    physics.measure(figures, quick, tell)
    figures[PEER_FIGURE] = None
    if peer is not None:
        tell("MuJoCo ...")
        peer.measure(figures)
    return figures


def _mujoco() -> Any:
    try:
        from benchmarks.cloth import mujoco_peer
    except ModuleNotFoundError as e:
        if e.name != "mujoco":
            raise
        raise ConfigurationError(
            "MuJoCo is not installed", "install the optional extra: pip install -c constraints.txt -e '.[peers]'"
        ) from e
    return mujoco_peer
