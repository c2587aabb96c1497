"""JUnit results of scripts are well-formed for any name and message."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest

from cell.campaigns.hil.junit import junit_text


@pytest.mark.parametrize("strange", ["\x07", "\x1b[31m", "\udcff", "\ufffe", "ä & <b>", "\U0001f9e6"])
def test_the_junit_file_is_valid_xml_for_any_script_name_and_message(strange: str) -> None:
    script: Any = SimpleNamespace(name=f"drop{strange}", path=Path(f"/scripts/drop{strange}.yaml"))
    failed: Any = SimpleNamespace(
        passed=False, seconds=1.5, script=script, broken=(f"broke {strange}", "and more"),
        result=SimpleNamespace(run_dir=f"/logs/{strange}"),
    )  # fmt: skip
    suite = ElementTree.fromstring(junit_text([failed], [script]))
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == ("2", "1", "1")
    case, skipped = suite.findall("testcase")
    failure = case.find("failure")
    assert failure is not None and failure.text is not None and failure.text.endswith("\nand more")
    assert str(case.get("name")).startswith("drop") and str(skipped.get("name")).startswith("drop")
