"""The rule by which tests of optional parts may be skipped, and the summary of skipped tests."""

from __future__ import annotations

import pytest

from tests.optional_parts import ALLOWED_SKIPS, MUJOCO, ROS, may_be_skipped, skip_summary


@pytest.mark.parametrize(
    ("allowed", "reason", "expected"),
    [
        (None, "any reason", True),
        ("", ROS.reason, False),
        ("ROS", ROS.reason, True),
        ("browser, ROS", ROS.reason, True),
        ("ROS", MUJOCO.reason, False),
        ("ROS", "any reason", False),
    ],
)
def test_only_allowed_skips_pass_if_the_variable_is_set(allowed: str | None, reason: str, expected: bool) -> None:
    environment = {} if allowed is None else {ALLOWED_SKIPS: allowed}
    assert may_be_skipped(reason, environment) is expected


def test_the_skip_summary_counts_skips_and_names_the_install_command() -> None:
    line = skip_summary([ROS.reason, "any reason", ROS.reason])
    assert line == f"left out: 2 tests ({ROS.reason}: {ROS.install}), 1 test (any reason)"
    assert skip_summary([]) == ""
