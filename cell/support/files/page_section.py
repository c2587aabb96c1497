"""A section of a documentation page that a program writes, between two marks."""

from __future__ import annotations

from cell.support.files.paths import repository_root
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError

__all__ = ["with_section", "write_section"]


def with_section(page: str, name: str, text: str) -> str:
    """Return the page with `text` between the marks of the section. Raises ConfigurationError if it has no
    marks."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    if begin not in page or end not in page:
        raise ConfigurationError(f"the page has no marks {begin} and {end}", "add them where the section belongs")
    before, rest = page.split(begin, 1)
    return f"{before}{begin}\n{text}{end}{rest.split(end, 1)[1]}"


def write_section(name: str, text: str) -> None:
    """Write a section of docs/safety.md. Raises ConfigurationError outside a checkout of the program."""
    root = repository_root()
    if root is None:
        raise ConfigurationError("the documentation is not installed", "run this in a checkout of the program")
    page = root / "docs" / "safety.md"
    write_whole(page, with_section(page.read_text(encoding="utf-8"), name, text))
