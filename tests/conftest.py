"""Settings of the whole suite: untimed properties, and the skips that are allowed."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from tests.optional_parts import ALLOWED_SKIPS, may_be_skipped, skip_summary

# A busy machine is no defect: neither a property nor the drawing of its examples is timed.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")


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
    """The reason of a skip without pytest's own prefix."""
    where = report.longrepr
    return str(where[2] if isinstance(where, tuple) else where).removeprefix("Skipped: ")


def pytest_terminal_summary(terminalreporter: Any) -> None:
    line = skip_summary(reason_of(report) for report in terminalreporter.stats.get("skipped", ()))
    if line:
        terminalreporter.write_line(line)
