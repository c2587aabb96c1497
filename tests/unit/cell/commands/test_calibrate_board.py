"""`foldcell calibrate board`: the detector finds the printed board at its stated size."""

from __future__ import annotations

import json
import re
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from foldcell.calibration.board import BOARD, find_board
from foldcell.calibration.board_sheet import draw_sheet
from foldcell.cell.commands.main import main


def written(path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert main(["calibrate", "board", "--output", str(path), "--json"]) == 0
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def png(path: Path) -> tuple[np.ndarray, float]:
    """(h, w) picture, and the pixel size that the file states [mm]."""
    content = path.read_bytes()
    at = content.index(b"pHYs")
    across, down, unit = struct.unpack(">IIB", content[at + 4 : at + 13])
    assert across == down and unit == 1 and at < content.index(b"IDAT")
    assert struct.unpack(">I", content[at + 13 : at + 17])[0] == zlib.crc32(content[at : at + 13])
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    return picture, 1e3 / across


def corners_mm(picture: np.ndarray, pixel: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices and positions (n, 2) [mm] of the corners that the detector finds."""
    view = find_board(cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB))
    assert view is not None
    return view.index, view.pixels * pixel


def test_the_printed_board_is_found_at_its_stated_size(tmp_path: Path, capsys) -> None:
    told = written(tmp_path / "board.png", capsys)
    picture, pixel = png(tmp_path / "board.png")
    assert told["dpi"] == pytest.approx(25.4 / pixel, abs=0.05) and told["file"].endswith("board.png")
    assert [n * pixel for n in picture.shape[::-1]] == pytest.approx([297, 210]) == told["page_mm"]
    assert set(np.unique(picture)) == {0, 255}

    index, places = corners_mm(picture, pixel)
    assert sorted(index) == list(range((BOARD.columns - 1) * (BOARD.rows - 1)))
    meant = 1e3 * BOARD.corners[index, :2]
    gaps = [np.linalg.norm(p[:, None] - p[None], axis=2) for p in (places, meant)]
    assert np.abs(gaps[0] - gaps[1]).max() < 0.02
    assert (places - meant).mean(axis=0) == pytest.approx([297 / 2, 210 / 2], abs=0.1), (
        "the board is in the middle of the page"
    )
    assert told["square_mm"] == 36.0 and told["pattern_mm"] == [7 * 36.0, 5 * 36.0]


def test_the_ruler_has_its_printed_length(tmp_path: Path, capsys) -> None:
    told = written(tmp_path / "board.png", capsys)
    picture, pixel = png(tmp_path / "board.png")
    below = picture[round((210 + told["pattern_mm"][1]) / 2 / pixel) + 10 :, :]
    line = below[int(np.argmax((below == 0).sum(axis=1)[: round(9 / pixel)]))]  # above the cutting line
    x = np.flatnonzero(line == 0)
    run = max(np.split(x, np.flatnonzero(np.diff(x) > 1) + 1), key=len)
    assert (run[-1] - run[0]) * pixel == pytest.approx(told["ruler_mm"], abs=0.35), (
        "half a line width is added at each end"
    )
    upper = below[: round(3.8 / pixel)]  # above the line are the two long ticks
    first, last = ((upper[:, i : i + 200] == 0).any(axis=0).nonzero()[0].mean() + i for i in (200, 1350))
    assert (last - first) * pixel == pytest.approx(told["ruler_mm"], abs=0.05)


def test_text_and_ruler_do_not_disturb_the_detection() -> None:
    sheet = draw_sheet()
    small = cv2.resize(sheet, (640, round(640 * 210 / 297)), interpolation=cv2.INTER_AREA)
    index, places = corners_mm(small, 297 / 640)
    assert len(index) == 24
    assert np.abs(places - places.mean(axis=0) - 1e3 * BOARD.corners[index, :2]).max() < 0.2


def test_the_pdf_shows_the_same_page_as_the_picture(tmp_path: Path, capsys) -> None:
    written(tmp_path / "board.pdf", capsys)
    content = (tmp_path / "board.pdf").read_bytes()
    box = re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", content)
    drawn = re.search(rb"q ([\d.]+) 0 0 ([\d.]+) 0 0 cm", content)
    assert box and drawn and box.groups() == drawn.groups(), "the picture fills the page"
    assert [float(n) * 25.4 / 72 for n in box.groups()] == pytest.approx([297, 210], abs=1e-3)
    assert b"/PrintScaling /None" in content

    start = int(re.search(rb"startxref\n(\d+)\n%%EOF", content)[1])
    assert content[start:].startswith(b"xref\n0 6\n")
    for number, at in enumerate(re.findall(rb"(\d{10}) 00000 n ", content[start:]), 1):
        assert content[int(at) :].startswith(b"%d 0 obj" % number)

    head = re.search(rb"/Width (\d+) /Height (\d+) .*?/Length (\d+) >>\nstream\n", content)
    w, h, length = (int(n) for n in head.groups())
    bits = np.frombuffer(zlib.decompress(content[head.end() : head.end() + length]), np.uint8).reshape(h, -1)
    assert (np.unpackbits(bits, axis=1)[:, :w] * 255 == draw_sheet()).all()


@pytest.mark.parametrize(("name", "word"), [("board.svg", "PDF"), ("no/such/folder/board.pdf", "no such folder")])
def test_an_unwritable_output_is_refused(name: str, word: str, tmp_path: Path, capsys) -> None:
    assert main(["calibrate", "board", "--output", str(tmp_path / name), "--json"]) == 64
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert word in told["error"] and told["hint"] and list(tmp_path.iterdir()) == []


def test_the_board_command_prints_instructions(tmp_path: Path, capsys) -> None:
    assert main(["calibrate", "board", "--output", str(tmp_path / "board.png")]) == 0
    said = capsys.readouterr().out
    for word in ("DICT_4X4_50", "36", "304.8", "100 %", "100 mm", "276 x 204 mm", "tab"):
        assert word in said
