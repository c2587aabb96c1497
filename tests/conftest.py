"""Settings of the whole suite: untimed properties, the skips that are allowed, and the tests that take long."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Generator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from foldcell.cell.commands.main import GARBAGE
from tests.optional_parts import ALLOWED_SKIPS, may_be_skipped, skip_summary

# A busy machine is no defect, so neither a property nor the generation of its examples has a time limit.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

# Python looks for garbage as often as in a command. With its own number, this took a tenth of the suite's time.
gc.set_threshold(GARBAGE)

# A shell that starts the suite in the background lets it ignore SIGINT, and the commands that the tests start and
# interrupt would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

UNIT = Path(__file__).parent / "unit"
COMPUTES_CLOTH = (
    "benchmarks/test_bench_cloth.py",
    "benchmarks/test_calibrated.py",
    "benchmarks/test_claim_matrix.py",
    "benchmarks/test_ideal_folds.py",
    "calibration/test_crease.py",
    "calibration/test_identify.py",
    "calibration/test_material_tests.py",
    "calibration/test_mujoco_peer.py",
    "cell/planning/test_trajectory_library_build.py",
    "cell/commands/test_calibrate_fabric.py",
    "cell/commands/test_garment_check.py",
    "cell/commands/test_optimise_command.py",
    "cell/config/test_fabric_file.py",
    "cell/config/test_ideal_heights_file.py",
    "cell/executive/effects/test_effects_adapting.py",
    "cell/executive/effects/test_effects_planning.py",
    "cell/simulation/faults/test_world_faults.py",
    "cell/simulation/test_cloth_body.py",
    "cell/simulation/test_ideal.py",
    "skills/test_score.py",
    "cell/simulation/test_world.py",
    "foldcell/test_api_optimise.py",
    "skills/cloth",
    "skills/trajectory",
)
COMPILES = ("cell/operator/progress/test_compiling.py",)
DRAWS_PICTURES = (
    "benchmarks/test_photographs.py",
    "benchmarks/test_real_photographs.py",
    "cell/commands/test_perceive_command.py",
    "cell/config/test_new_garment.py",
    "cell/hardware/test_own_picture.py",
    "cell/report/test_film.py",
    "cell/report/test_report.py",
    "cell/simulation/test_camera_sensor.py",
    "foldcell/test_api_perceive.py",
    "foldcell/test_api_threads.py",
    "skills/perception",
    "skills/state_estimate",
)
PLANS_MOTIONS = (
    "calibration/test_hand_eye.py",
    "cell/calibrating",
    "cell/campaigns/ladder",
    "cell/commands/test_absurd_cells.py",
    "cell/commands/test_robot_commands.py",
    "cell/control/test_trajectory_motion.py",
    "cell/hardware/test_camera_place.py",
    "cell/hardware/test_driver_contract.py",
    "robots/test_robot_models.py",
    "skills/motion/test_fold_motion.py",
    "skills/motion/test_timing.py",
)
PERFORMS_MANY_RUNS = (
    "cell/campaigns/trials/test_perform_trial.py",
    "cell/commands/test_fault_trials_command.py",
    "cell/executive/test_every_failure.py",
    "cell/executive/test_random_runs.py",
)
DRAWS_MANY_READINGS = (
    "calibration/test_camera_calibration.py",
    "calibration/test_tactile_calibration.py",
    "skills/grasping/test_close_confirm.py",
    "skills/grasping/test_descend.py",
    "skills/grasping/test_slip_release.py",
)
STARTS_PROGRAMS = (
    "benchmarks/test_kill_points.py",
    "benchmarks/test_planted_faults.py",
    "benchmarks/test_random_cases.py",
    "benchmarks/test_start.py",
    "cell/campaigns/test_perform_campaign.py",
    "cell/commands/test_cli.py",
    "cell/commands/test_dashboard_command.py",
    "cell/commands/test_doctor.py",
    "cell/operator/console/test_console.py",
    "cell/operator/console/test_page.py",
    "cell/operator/key_points/test_key_point_page.py",
    "cell/support/process/test_library_messages.py",
    "cell/support/process/test_workers.py",
    "cell/view/test_recorder.py",
    "test_wheel.py",
    "test_site.py",
)
LONG = tuple(
    UNIT / place
    for group in (
        COMPUTES_CLOTH,
        COMPILES,
        DRAWS_PICTURES,
        PLANS_MOTIONS,
        PERFORMS_MANY_RUNS,
        DRAWS_MANY_READINGS,
        STARTS_PROGRAMS,
    )
    for place in group
)
assert all(place.exists() for place in LONG)


def pytest_xdist_auto_num_workers() -> int:
    """One worker more than cores: tests in real time, and those that start programs, mostly wait."""
    return len(os.sched_getaffinity(0)) + 1


@cache
def is_in(path: Path, places: tuple[Path, ...]) -> bool:
    """Whether a file of tests is one of `places`, or in one of them. Each file has many tests."""
    return any(path.is_relative_to(place) for place in places)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """A file whose tests are all left out is not imported."""
    return True if "not long" in config.option.markexpr and is_in(collection_path, LONG) else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        talks_over_ros = "rosmaster" in getattr(item, "fixturenames", ())
        if talks_over_ros or is_in(item.path, LONG):
            item.add_marker(pytest.mark.long)
    # Cloth comes last: by then the worker with the whole runs has compiled the solver, which takes a minute.
    cloth = tuple(UNIT / place for place in COMPUTES_CLOTH)
    items.sort(key=lambda item: is_in(item.path, cloth))


def pytest_collection_finish() -> None:
    """The collected tests stay to the end, so no search for garbage goes through them."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.skipped and not hasattr(report, "wasxfail"):
        fail_unless_allowed(report)
    return report


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    if report.skipped:
        fail_unless_allowed(report)
    return report


def fail_unless_allowed(report: Any) -> None:
    if not may_be_skipped(reason_of(report)):
        report.outcome = "failed"
        report.longrepr = f"skipped, and {ALLOWED_SKIPS} does not allow it: {reason_of(report)}"


def reason_of(report: Any) -> str:
    """The reason of a skip, without pytest's prefix."""
    where = report.longrepr
    return str(where[2] if isinstance(where, tuple) else where).removeprefix("Skipped: ")


def pytest_terminal_summary(terminalreporter: Any) -> None:
    line = skip_summary(reason_of(report) for report in terminalreporter.stats.get("skipped", ()))
    if line:
        terminalreporter.write_line(line)
