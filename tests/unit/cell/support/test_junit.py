"""JUnit results are well-formed for any name and message."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from foldcell.cell.support.junit import JUnitCase, junit_text


@pytest.mark.parametrize("strange", ["\x07", "\x1b[31m", "\udcff", "\ufffe", "ä & <b>", "\U0001f9e6"])
def test_the_junit_file_is_valid_xml_for_any_name_and_message(strange: str) -> None:
    broken, name = (f"broke {strange}", "and more"), f"drop{strange}"
    failed = JUnitCase(name, broken, seconds=1.5, file=f"/scripts/{name}.yaml", output=f"/logs/{strange}")
    left = JUnitCase(name, skipped=f"interrupted {strange}")
    suite = ElementTree.fromstring(junit_text("foldcell hil", [failed, left]))
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == ("2", "1", "1")
    case, skipped = suite.findall("testcase")
    failure = case.find("failure")
    assert failure is not None and failure.text is not None and failure.text.endswith("\nand more")
    assert (case.get("classname"), case.get("time"), skipped.get("time")) == ("hil", "1.5", None)
    assert str(case.get("name")).startswith("drop") and str(skipped.get("name")).startswith("drop")
