"""Write the results of scripts as a JUnit file, which build servers display as tests."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from cell.campaigns.hil.script import Script
from cell.campaigns.hil.script_run import ScriptResult

__all__ = ["junit_text"]

NONCHARACTERS = "\ufffe\uffff"


def junit_text(results: Sequence[ScriptResult], left: Sequence[Script] = ()) -> bytes:
    """Return the text of a JUnit file: one test case per script, with its broken expectations and its run folder.
    left: scripts that were not run; they are reported as skipped."""
    failed = sum(not p.passed for p in results)
    seconds = sum(p.seconds for p in results)
    suite = ElementTree.Element(
        "testsuite", name="foldcell hil", tests=str(len(results) + len(left)), failures=str(failed),
        skipped=str(len(left)), time=f"{seconds:.1f}",
    )  # fmt: skip
    for p in results:
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
        ElementTree.SubElement(case, "skipped", message="interrupted before it was run")
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True) + b"\n"


def _plain(text: str) -> str:
    """Replace characters that XML does not allow (control characters, surrogates) with question marks."""
    return "".join(
        c if c in "\n\t" or " " <= c < "\ud800" or "\ue000" <= c not in NONCHARACTERS else "?" for c in text
    )
