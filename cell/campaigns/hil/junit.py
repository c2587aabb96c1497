"""The results of scripts as a JUnit file, which build servers show as tests."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from cell.campaigns.hil.script import Script
from cell.campaigns.hil.script_run import ScriptResult

__all__ = ["junit_text"]

NO_LETTERS = "\ufffe\uffff"


def junit_text(performances: Sequence[ScriptResult], left: Sequence[Script] = ()) -> bytes:
    """One test case a script, with what was not as expected and the run's folder. left: scripts that were not
    performed any more, as skipped."""
    failed = sum(not p.passed for p in performances)
    seconds = sum(p.seconds for p in performances)
    suite = ElementTree.Element(
        "testsuite", name="foldcell hil", tests=str(len(performances) + len(left)), failures=str(failed),
        skipped=str(len(left)), time=f"{seconds:.1f}",
    )  # fmt: skip
    for p in performances:
        case = ElementTree.SubElement(
            suite, "testcase", classname="hil", name=_plain(p.script.name), time=f"{p.seconds:.1f}"
        )
        case.set("file", _plain(str(p.script.path)))
        if not p.passed:
            ElementTree.SubElement(case, "failure", message=_plain(p.broken[0])).text = _plain("\n".join(p.broken))
        if p.result is not None:
            ElementTree.SubElement(case, "system-out").text = _plain(p.result.run_dir)
    for script in left:
        case = ElementTree.SubElement(suite, "testcase", classname="hil", name=_plain(script.name))
        ElementTree.SubElement(case, "skipped", message="interrupted before it was performed")
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True) + b"\n"


def _plain(text: str) -> str:
    """With a question mark in place of what XML cannot hold: control characters, halves of a character."""
    return "".join(
        c if c in "\n\t" or " " <= c < "\ud800" or "\ue000" <= c not in NO_LETTERS else "?" for c in text
    )
