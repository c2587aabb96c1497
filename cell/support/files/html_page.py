"""Read the HTML pages of the program, which share one palette (palette.css).

A page has the line PLACE in its style. Reading replaces this line by the palette, so that every page is complete
in itself. The colour `mark` is for charts of good and bad runs, also for readers who cannot tell red from green.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import jinja2

PLACE = "/* palette */\n"
PALETTE = Path(__file__).with_name("palette.css")


def read_page(path: Path) -> str:
    """Return the text of a page or template with its colours."""
    return path.read_text(encoding="utf-8").replace(PLACE, PALETTE.read_text(encoding="utf-8"))


@lru_cache(maxsize=16)
def page_template(path: Path, /, **filters: Callable[..., Any]) -> jinja2.Template:
    """Return the template of a page with its colours. Other templates that it names are read from its folder.

    Inserted texts are escaped. A name that the page uses and that has no value is an error. A template is compiled
    once: a campaign writes its page again and again.
    """
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda name: read_page(path.with_name(name))), autoescape=True,
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters.update(filters)
    return environment.get_template(path.name)
