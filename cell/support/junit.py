"""Write results as a JUnit file, which build servers display as tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

NONCHARACTERS = "\ufffe\uffff"


@dataclass(frozen=True)
class JUnitCase:
    """One case. broken: why it failed, a sentence each; empty if it passed. skipped: why it was not performed.
    seconds: wall time, None if it was not performed. file: of the case. output: shown with it."""

    name: str
    broken: Sequence[str] = ()
    skipped: str = ""
    seconds: float | None = None
    file: str = ""
    output: str = ""


def junit_text(suite: str, cases: Sequence[JUnitCase]) -> bytes:
    """Return the text of a JUnit file. suite: `foldcell` and the command, whose last word is the class of the
    cases."""
    root = ElementTree.Element(
        "testsuite", name=suite, tests=str(len(cases)), failures=str(sum(bool(case.broken) for case in cases)),
        skipped=str(sum(bool(case.skipped) for case in cases)),
        time=f"{sum(case.seconds or 0.0 for case in cases):.1f}",
    )  # fmt: skip
    for case in cases:
        element = ElementTree.SubElement(root, "testcase", classname=suite.split()[-1], name=_plain(case.name))
        if case.seconds is not None:
            element.set("time", f"{case.seconds:.1f}")
        if case.file:
            element.set("file", _plain(case.file))
        if case.broken:
            ElementTree.SubElement(element, "failure", message=_plain(case.broken[0])).text = _plain(
                "\n".join(case.broken)
            )
        if case.output:
            ElementTree.SubElement(element, "system-out").text = _plain(case.output)
        if case.skipped:
            ElementTree.SubElement(element, "skipped", message=_plain(case.skipped))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _plain(text: str) -> str:
    """Replace characters that XML does not allow (control characters, surrogates) with question marks."""
    return "".join(
        c if c in "\n\t" or " " <= c < "\ud800" or "\ue000" <= c not in NONCHARACTERS else "?" for c in text
    )
