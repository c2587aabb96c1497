"""Measures figures of the cloth solver, in parts: foldcell bench cloth [--only PART,...] [--keep FILE].

Speeds are simulated seconds over CPU seconds of the computing thread (`time.thread_time`), so other work on the
machine has little effect. A speed is the best of three measurements; that of a peer, which takes minutes, comes
from one. two_threads_x_throughput is measured in wall time and needs an idle machine. Errors are differences from
closed forms (block on a slope, hung strip, Peirce's cantilever) or, with peers, from MuJoCo's flex. Everything is
simulated.
"""

from __future__ import annotations

import importlib
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.kept import Kept, fingerprint
from foldcell.robots.errors import ConfigurationError

Tell = Callable[[str], None]
"""Function that shows one line of progress to the user."""
PEER_FIGURE = "mujoco_final_error_difference_mm"
MEASURED = ("skills/cloth", "skills/fold_plan", "skills/garments", "calibration", "benchmarks/cloth")


@dataclass(frozen=True)
class Part:
    """One part of the benchmark.

    function: MODULE:FUNCTION in this package, called as `function(quick, tell)`; it returns figures, and reports
    its progress if it takes minutes. about: text for the user. needs: package that this part needs, if it measures
    a peer.
    """

    function: str
    about: str
    needs: str | None = None

    def measure(self, quick: bool, tell: Tell) -> dict[str, Any]:
        module, function = self.function.split(":")
        return dict(getattr(importlib.import_module(f"benchmarks.cloth.{module}"), function)(quick, tell))


PARTS: Mapping[str, Part] = {
    "towel": Part("speed:towel", "the towel of 425 vertices folded in half and in quarters"),
    "sizes": Part("speed:sizes", "towels of 400 to 20 000 vertices"),
    "threads": Part("speed:threads", "two simulations in two threads"),
    "start": Part("speed:start", "a new process until its first fold"),
    "substeps": Part("refinement:substeps", "folds with fewer and more substeps"),
    "shirt": Part("contact:shirt", "the two-layer shirt of about 1300 vertices in three folds"),
    "sides": Part("contact:sides", "the shirt's sleeves folded in together with its sides"),
    "variants": Part("contact:variants", "the same with other friction, thickness and speed"),
    "starts": Part("contact:starts", "shirt and all shipped garments from starts that differ by 1e-6 m"),
    "determinism": Part("determinism:same_bits", "the same bits in another process and thread"),
    "conservation": Part("physics:conservation", "momentum, energy and rest"),
    "tilt": Part("physics:tilt", "tilted table"),
    "layers": Part("physics:layers", "a layer on a layer on the tilted table"),
    "strip": Part("physics:hang_strip", "hung strips"),
    "bending": Part("physics:bending", "cantilevers"),
    "grasp": Part("physics:grasp", "what the pads hold"),
    "mesh": Part("meshes:quality", "meshes of all garments"),
    "garment": Part("calibrated:hung", "hung garments, calibrated on one mesh and hung again on others"),
    "friction": Part("calibrated:friction", "the paper's friction test of all garments"),
    "identify": Part("calibrated:identified", "friction from one recorded fold"),
    "mujoco_lab": Part("mujoco_peer:lab", "MuJoCo: the laboratory's tests", "mujoco"),
    "mujoco_refinement": Part("mujoco_peer:refinement", "MuJoCo: what its own refinement changes", "mujoco"),
    "mujoco_folds": Part("mujoco_peer:folds", "MuJoCo: the same towel folds", "mujoco"),
    "mujoco_optimised": Part("mujoco_peer:optimised", "MuJoCo: our optimised towel fold", "mujoco"),
}


def measure(
    tell: Tell, *, peers: bool, quick: bool, only: Sequence[str] = (), keep: Path | None = None
) -> dict[str, Any]:
    """Measure the parts. Return one flat mapping of figures with units in the keys. Without `peers`, it has no
    figures of the peers, and PEER_FIGURE is None.

    only: names of PARTS. keep: a file to which the figures of each part are saved as soon as it is measured. Parts
    that are already in the file, measured with the same sources, are not measured again. Raises ConfigurationError
    for an unknown part, a peer that is not installed, or a file that cannot be written or is not one of this
    benchmark.
    """
    chosen = _chosen(only, peers)
    kept, key = Kept(_checked(keep)), fingerprint(MEASURED, quick=quick)
    figures: dict[str, Any] = {}
    for k, (name, part) in enumerate(chosen.items()):
        before = kept.get(key, name)
        if before is not None:
            tell(f"{k + 1:2d}/{len(chosen)} {name}: kept")
            figures |= before
            continue
        tell(f"{k + 1:2d}/{len(chosen)} {name}: {part.about} ...")
        start = time.process_time()
        found = part.measure(quick, lambda text: tell(f"      {text}"))
        tell(f"      {time.process_time() - start:.0f} s of CPU")
        kept.put(key, name, found)
        figures |= found
    figures |= _derived(figures)
    return figures if only else {PEER_FIGURE: None} | figures


def _chosen(only: Sequence[str], peers: bool) -> dict[str, Part]:
    unknown = [name for name in only if name not in PARTS]
    if unknown:
        raise ConfigurationError(f"bench cloth has no part {unknown[0]!r}", f"it has {', '.join(PARTS)}")
    chosen = {n: p for n, p in PARTS.items() if (n in only if only else peers or p.needs is None)}
    for part in chosen.values():
        if part.needs is not None:
            try:
                importlib.import_module(part.needs)
            except ModuleNotFoundError as e:
                raise ConfigurationError(
                    f"the peer {part.needs} is not installed",
                    "install the optional extra: pip install -c constraints.txt -e '.[peers]'",
                ) from e
    return chosen


def _derived(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Compute the figures that need the results of two parts."""
    out: dict[str, Any] = {}
    strip, garment = (figures.get(f"hang_{name}_error_pp_max") for name in ("strip", "garment"))
    if strip is not None and garment is not None:
        out["hang_error_pp_max"] = max(strip, garment)
    ours, theirs = figures.get("towel_425_x_realtime"), figures.get("mujoco_towel_x_realtime")
    if ours and theirs:
        out["towel_425_speed_over_mujoco"] = ours / theirs
    return out


def _checked(path: Path | None) -> Path | None:
    """Check now that figures can be saved to the file, so that none is lost. Raises ConfigurationError."""
    if path is None:
        return None
    if not os.access(path.parent, os.W_OK):
        raise ConfigurationError(f"{path} cannot be written", "give --keep a file in a folder that can")
    try:
        ours = not path.exists() or isinstance(json.loads(path.read_text(encoding="utf-8")), dict)
    except (OSError, ValueError):
        ours = False
    if not ours:
        raise ConfigurationError(f"{path} holds no figures of bench cloth", "give --keep another file")
    return path
