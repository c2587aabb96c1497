"""Write the pages of docs/look_up that the program's code determines: `python -m benchmarks.reference`."""

from __future__ import annotations

from benchmarks.reference.pages import FOLDER, pages
from foldcell.cell.support.files.whole_file import write_whole

if __name__ == "__main__":
    for name, text in pages().items():
        write_whole(FOLDER / name, text)
