"""Write scripts of tests/hil/faults from the table of faults: one run of a small towel for each fault of NAMES.

python -m benchmarks.fault_scripts
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from foldcell.cell.campaigns.faults.fault_table import DueEnd, FaultTable, read_fault_table
from foldcell.cell.campaigns.faults.fault_trials import drawn_action

FOLDER = Path(__file__).parents[1] / "tests" / "hil" / "faults"
GARMENT, SEED = "small_towel", 1
NAMES = (
    "joint_state_nan_for_good", "arm_hangs_for_good", "setpoints_starved", "program_stalled_longer",
    "clock_steps_far_ahead", "stop_flaps", "camera_black_for_good", "second_garment_for_good",
    "tactile_dead_for_good", "slip", "garment_taken_away", "joint_state_frozen", "camera_late",
    "camera_without_depth_for_good", "camera_wrong_size_for_good", "hand_in_view_for_good", "gripper_offset",
    "gripper_error", "gripper_uncalibrated", "garment_shoved", "caught_on_finger",
)  # fmt: skip
"""Faults of each part of the cell; each script was performed once before it was added."""
HEAD = "# written by `python -m benchmarks.fault_scripts` from cell/campaigns/faults/fault_table.yaml\n"


def script(table: FaultTable, name: str) -> str:
    """Return the script of a fault: its moment, side and direction are drawn as in a campaign of faults."""
    entry, action = table.faults[name], drawn_action(table, name, GARMENT, SEED)
    stated = action.model_dump(mode="json", exclude_defaults=True)
    lines = [
        f"about: {_flow(f'{name} -- {entry.why}'.replace('_', ' '))}",
        f"garment: {GARMENT}",
        f"seed: {SEED}",
        "do:",
        f"  - when: {_flow(stated['when'])}",
        f"    fault: {_flow(stated['fault'])}",
        "expect:",
        *(f"  {key}: {_flow(value)}" for key, value in _expected(set(entry.end), entry.displaces).items()),
    ]
    return HEAD + "\n".join(lines) + "\n"


def _expected(due: set[DueEnd], displaced: bool) -> dict[str, Any]:
    """Return the expectations of a script. A garment that the fault displaces may drift further than is passed."""
    if DueEnd.SAFE in due:
        return {"end": ["stopped", "fault", "not_folded"]}
    ends = {DueEnd.RECOVERED: "folded", DueEnd.ASKED: "not_folded"}
    expected: dict[str, Any] = {"end": [ends[end] for end in DueEnd if end in due], "parked": True}
    return {**expected, "passed": True} if due == {DueEnd.RECOVERED} and not displaced else expected


def _flow(value: Any) -> str:
    return (
        yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=1000).removesuffix("\n...\n").strip()
    )


if __name__ == "__main__":
    shipped = read_fault_table()
    for each in NAMES:
        (FOLDER / f"{each}.yaml").write_text(script(shipped, each), encoding="utf-8")
    print(f"{len(NAMES)} scripts in {FOLDER}")
