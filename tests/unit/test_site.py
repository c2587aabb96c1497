"""The site of docs: it opens as files, without a network, and its search finds words."""

from __future__ import annotations

import shutil
import subprocess
import time
from pathlib import Path

from benchmarks.operator.chromium import Chromium, Tab
from tests.optional_parts import BROWSER, SITE, SITE_PROGRAM

ROOT = Path(__file__).resolve().parents[2]
SEARCH = "document.activeElement.shadowRoot"


def found(tab: Tab, script: str) -> None:
    """Wait until the script yields something."""
    deadline = time.monotonic() + 60.0
    while not tab.evaluate(script):
        if time.monotonic() > deadline:
            raise TimeoutError(script)
        time.sleep(0.1)


@BROWSER.required
@SITE.required
def test_the_site_is_searched_as_files_without_asking_anybody(tmp_path: Path) -> None:
    shutil.copy(ROOT / "zensical.toml", tmp_path)
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    assert SITE_PROGRAM is not None
    subprocess.run([SITE_PROGRAM, "build", "--strict"], cwd=tmp_path, check=True, capture_output=True)
    site = tmp_path / "build" / "site"
    with Chromium() as browser:
        tab = browser.open((site / "do" / "safety.html").as_uri())
        found(tab, "document.querySelector('.md-search__button') && document.readyState === 'complete'")
        tab.evaluate("document.querySelector('.md-search__button').click()")
        found(tab, f"{SEARCH}?.querySelector('input') && true")
        tab.call("Input.insertText", text="elastica")
        found(tab, f"{SEARCH}.textContent.includes('Results: height of creases over the mesh')")
        assert [address for address in tab.requests if not address.startswith(("file:", "data:"))] == []
