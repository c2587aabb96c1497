"""Pages of the program: all have the colours of one palette."""

from __future__ import annotations

from pathlib import Path

import pytest

from foldcell import cell
from foldcell.cell.support.files.html_page import PLACE, read_page

PAGES = [page for page in Path(cell.__path__[0]).rglob("*.html") if "var(--" in page.read_text(encoding="utf-8")]
COMPLETE = [page for page in PAGES if "{% extends" not in page.read_text(encoding="utf-8")]


@pytest.mark.parametrize("page", COMPLETE, ids=lambda page: f"{page.parent.name}/{page.stem}")
def test_a_page_defines_the_colours_that_it_uses_by_the_palette_alone(page: Path) -> None:
    own, whole = page.read_text(encoding="utf-8"), read_page(page)
    assert PLACE in own and PLACE not in whole
    assert "--ground:" not in own and whole.count("--ground:") == 2, "a light and a dark value"
    used = {part.split(")")[0] for part in whole.split("var(--")[1:]}
    assert all(f"--{name}:" in whole for name in used)
