"""The table of faults: its content and its errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from foldcell.cell.campaigns.faults.fault_table import DueEnd, read_fault_table
from foldcell.cell.simulation import TRAITS, FaultKind
from foldcell.robots.errors import ConfigurationError

ROOT = Path(__file__).resolve().parents[5]
ENTRY = (
    'a_slip: {kind: slip, size: 0.1, place: world, stage: hold, end: recovered, why: "it is seen where it fell"}'
)


def a_table(folder: Path, entry: str) -> Path:
    path = folder / "table.yaml"
    path.write_text(
        f"stages:\n  hold: {{visits: 2, during: {{lifting: 0.5, folding: 3.0}}}}\nfaults:\n  {entry}\n"
    )
    return path


def test_the_shipped_table_has_every_kind_of_fault() -> None:
    assert {entry.kind for entry in read_fault_table().faults.values()} == set(FaultKind)


def test_every_fault_that_can_last_for_good_or_for_a_moment_states_what_is_due_in_both_cases() -> None:
    """Sensors and actuators fail for a moment and for good. A person is needed only in the second case."""
    table = read_fault_table()
    for name, entry in table.faults.items():
        if name.endswith("_for_good"):
            assert entry.duration_s is None and not entry.recoverable, name
            assert table.faults[name.removesuffix("_for_good")].recoverable, name


def test_a_short_loss_is_recovered_and_a_stop_is_not() -> None:
    faults = read_fault_table().faults
    short = [
        e for e in faults.values() if e.kind.value.startswith(("camera", "joint", "tactile")) and e.duration_s
    ]
    assert short and all(e.recoverable for e in short)
    assert faults["stop_flaps"].end == (DueEnd.SAFE,)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (ENTRY.replace("kind: slip", "kind: slips"), "missed_grasp"),
        (ENTRY.replace("size: 0.1", "size: 1.5"), "a share is at most 1"),
        (ENTRY.replace("kind: slip,", "kind: no_garment,"), "has no size"),
        (ENTRY.replace("place: world", "place: ports"), "slip is injected into the world"),
        (ENTRY.replace("stage: hold", "stage: held"), "there is no stage 'held'"),
        (ENTRY.replace("end: recovered", "end: repaired"), "recovered, asked, safe"),
        (ENTRY.replace("end: recovered", "end: [asked, asked]"), "twice"),
        (ENTRY.replace('why: "it is seen where it fell"', 'reason: "none"'), "unknown key"),
    ],
)
def test_errors_name_the_line_and_what_is_allowed(tmp_path: Path, entry: str, message: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        read_fault_table(a_table(tmp_path, entry))
    assert message in str(caught.value)
    assert f"{tmp_path}/table.yaml:4" in str(caught.value)


def test_a_table_of_ones_own_is_read(tmp_path: Path) -> None:
    table = read_fault_table(a_table(tmp_path, ENTRY))
    assert table.faults["a_slip"].fault({"side": "left"}).at(3.0).extent == 0.1
    assert table.moment("a_slip").visits == 2


def test_a_stage_with_an_unknown_state_is_refused(tmp_path: Path) -> None:
    path = a_table(tmp_path, ENTRY)
    path.write_text(path.read_text().replace("folding", "dancing"))
    with pytest.raises(ConfigurationError, match="folding"):
        read_fault_table(path)


def test_sizes_are_stated_in_the_table_or_by_the_kind() -> None:
    for name, entry in read_fault_table().faults.items():
        traits = TRAITS[entry.kind]
        assert (traits.size is None) == (entry.fault({}).at(0.0).extent == 0.0), name
