"""Replay of a run's decisions from its transcript: all are equal, or the first difference is reported with its
place."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from foldcell.cell.commands.main import main
from foldcell.cell.hardware.driver import OpenCell
from foldcell.cell.journal.frame_store import FRAMES, FrameStore
from foldcell.cell.journal.journal import JournalRun
from foldcell.cell.runs.decide_again import Verdict, decide_again
from foldcell.cell.runs.fold_run import fold_once
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.observers import Step
from foldcell.cell.states.transition_table import Effect, Event
from foldcell.cell.transcript.channels import Channel
from foldcell.cell.transcript.replay_ports import NoRecordedAnswer
from foldcell.cell.transcript.transcript import TRANSCRIPT, Transcript
from foldcell.cell.transcript.transcript_codec import Exchange, Picture, unpack
from foldcell.robots.errors import ConfigurationError, StorageError
from foldcell.robots.ports import Clock, Ports, frozen
from tests.builders.transcripts import write_transcript
from tests.runs import decided_again, fold_request

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


@pytest.fixture
def copied(seen: Any, tmp_path: Path) -> JournalRun:
    """A copy of the run that a test may damage."""
    folder = tmp_path / seen.record.id
    shutil.copytree(seen.folder, folder, ignore=shutil.ignore_patterns("run.rrd", "*.html", "*.png"))
    return replace(seen.record, directory=folder)


def altered(run: JournalRun, alter: Callable[[list[Exchange]], list[Exchange]]) -> None:
    """Replace a run's transcript by an altered one."""
    transcript = Transcript(run.directory / TRANSCRIPT)
    write_transcript(run.directory, transcript.constants, alter(list(transcript)))


def answered(exchanges: list[Exchange], at: int, value: Any) -> list[Exchange]:
    """The exchanges with one answer replaced."""
    return [*exchanges[:at], replace(exchanges[at], answer=value), *exchanges[at + 1 :]]


def places(exchanges: list[Exchange], channel: Channel) -> list[int]:
    return [i for i, e in enumerate(exchanges) if e.channel is channel]


def decided(seen: Any, run: JournalRun) -> Verdict:
    return decide_again(run, seen.entries)


# replays without a difference


def test_replaying_a_whole_run_repeats_every_decision(seen: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Two folds with the optimiser's search on the same number of threads; set-points agree bit for bit."""
    line = ["replay", seen.record.id, "--decide", "--json", "--logs", str(seen.request.logs)]
    before = sorted(p.name for p in seen.request.logs.rglob("*"))
    assert main(line) == 0
    told = capsys.readouterr()
    figures = json.loads(told.out.splitlines()[-1])
    assert figures["same"] is True and figures["deviation"] is None and figures["broken_off"] is None
    assert figures["effects"] == sum(1 for e in seen.entries if e.kind == "result")
    assert figures["set_points"] == len(seen.onlooker.set_points)
    assert figures["cell_time_s"] == seen.entries[-1].cell_time
    assert figures["pictures"] == len(list((seen.folder / FRAMES).iterdir()))
    assert figures["exchanges"] > figures["set_points"] > 1000
    assert "folding" in told.err and "was" not in told.err.split("\n")[1], (
        "progress is shown, and no version has changed"
    )
    assert sorted(p.name for p in seen.request.logs.rglob("*")) == before, "the replay leaves no file"


def test_the_transcript_is_smaller_than_8_mb(seen: Any) -> None:
    assert (seen.folder / TRANSCRIPT).stat().st_size < 8e6


def test_a_truncated_transcript_is_compared_up_to_its_end(seen: Any, copied: JournalRun) -> None:
    altered(copied, lambda exchanges: exchanges[:4000])
    verdict = decided(seen, copied)
    assert verdict.same and verdict.exchanges == 4000
    assert verdict.broken_off == "the transcript breaks off here"
    assert 0.0 < verdict.cell_time_s < seen.entries[-1].cell_time and verdict.effects > 0


class WallClock:
    """A clock that never returns the same time twice, as the clock of a real cell."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def now(self) -> float:
        return self._clock.now() + time.perf_counter() % 1e-3

    def sleep_until(self, t: float) -> None:
        self._clock.sleep_until(t)


class GivesUp:
    """Ends a run before its first trajectory is chosen."""

    def __init__(self) -> None:
        self.commands = CommandQueue()

    def begin(self, cell: OpenCell, commands: CommandQueue) -> Ports:
        self.commands = commands
        return replace(cell.ports, simulated=False, clock=WallClock(cell.ports.clock))

    def entered(self, t: float, step: Step) -> None:
        if step.effect is Effect.CHOOSE_TRAJECTORY:
            self.commands.put(Event.ABORT)

    def performed(self, t: float, step: Step, result: Any) -> None: ...


def test_a_run_on_a_wall_clock_is_replayed_with_the_same_decisions(tmp_path: Path) -> None:
    """The run is not marked as simulated and its clock is irregular: decisions depend on the readings alone."""
    request, operator = fold_request(tmp_path, record=True), GivesUp()
    result = fold_once(request, operator.begin, (operator,))
    assert result.failure is not None and result.failure.kind == "aborted"
    transcript = Transcript(Path(result.run_dir) / TRANSCRIPT)
    assert not transcript.constants.simulated
    times = [e.answer for e in transcript if e.channel is Channel.NOW]
    assert len({t % 1e-3 for t in times}) > 30
    verdict = decided_again(request.logs)
    assert verdict.same and verdict.broken_off is None and verdict.set_points > 100


# replays with a difference


def test_an_altered_arm_reading_is_reported_where_it_changes_a_command(seen: Any, copied: JournalRun) -> None:
    """The head reading is altered, so no picture is taken."""
    pictures: list[int] = []

    def turn(exchanges: list[Exchange]) -> list[Exchange]:
        pictures.append(places(exchanges, Channel.CAPTURE)[0])
        at = max(k for k in places(exchanges, Channel.ARMS) if k < pictures[0])
        return answered(exchanges, at, replace(exchanges[at].answer, head_pan=0.5))

    altered(copied, turn)
    verdict = decided(seen, copied)
    there = verdict.deviation
    assert there is not None and verdict.exchanges == pictures[0]
    assert (there.state, there.effect) == ("photographing", "photograph_table")
    assert (there.then, there.now) == ("a picture", "a reading of the clock")
    (photograph,) = [e for e in seen.entries if e.kind == "intent" and e.name == "photograph_table"]
    assert there.cell_time_s == photograph.cell_time


def test_an_altered_picture_is_reported_where_recognition_fails(seen: Any, copied: JournalRun) -> None:
    """The garment is erased from the picture."""

    def erase(exchanges: list[Exchange]) -> list[Exchange]:
        store = FrameStore(copied.directory / FRAMES)
        empty, look = places(exchanges, Channel.CAPTURE)[:2]
        table, garment = (store.get(exchanges[i].answer.name) for i in (empty, look))
        rgb, depth = np.array(table.rgb), np.array(table.depth)
        rgb[0, 0] ^= 1  # identical colours or depths would count as an old picture
        depth[0, 0] = 0.5
        name = store.put(replace(garment, rgb=frozen(rgb), depth=frozen(depth)))
        return answered(exchanges, look, Picture(name))

    altered(copied, erase)
    there = decided(seen, copied).deviation
    assert there is not None
    (recognised, *_) = [i for i, e in enumerate(seen.entries) if (e.kind, e.name) == ("result", "recognise")]
    assert there.place == f"line {recognised + 1} of the journal"
    assert (there.state, there.effect) == (seen.entries[recognised].state, "recognise")
    assert there.cell_time_s == seen.entries[recognised].cell_time
    assert there.then.startswith("recognise ends: done") and there.now.startswith("recognise ends: failed")
    assert "no_garment" in there.now


def test_a_straying_arm_is_reported_at_the_tick_it_strays(seen: Any, copied: JournalRun) -> None:
    """One arm reading of the first motion is off by 0.5 rad, so the arms are commanded to hold."""
    at: list[int] = []

    def stray(exchanges: list[Exchange]) -> list[Exchange]:
        set_points = places(exchanges, Channel.SET_POINT)
        moving = [i for i in set_points if np.abs(unpack(exchanges[i].question)[1]).max() > 0.1]
        at.append(next(i for i in places(exchanges, Channel.ARMS) if i > moving[20]))
        state = exchanges[at[0]].answer
        return answered(exchanges, at[0], replace(state, q=frozen(state.q + 0.5)))

    altered(copied, stray)
    verdict = decided(seen, copied)
    there = verdict.deviation
    assert there is not None
    assert (there.state, there.effect) == ("approaching", "approach")
    assert 0 < verdict.exchanges - at[0] < 6, (
        "the difference is reported a few exchanges after the altered reading"
    )
    assert "tactile" in there.then and "a reading of the arms" in there.now


def test_changed_settings_are_reported_at_the_first_decision_they_change(seen: Any, copied: JournalRun) -> None:
    path = copied.directory / "cell.yaml"
    settings = yaml.safe_load(path.read_text(encoding="utf-8"))
    settings["computing"]["perception_s"] += 0.25
    path.write_text(yaml.safe_dump(settings), encoding="utf-8")
    there = decided(seen, copied).deviation
    assert there is not None
    assert (there.effect, there.then.split()[0], there.now.split()[0]) == ("recognise", "waiting", "waiting")
    assert float(there.now.split()[2]) - float(there.then.split()[2]) == pytest.approx(0.25)


def test_a_changed_program_is_reported_at_the_first_decision_it_changes(
    seen: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("foldcell.cell.executive.effects.moving.HEAD_TURN_S", 1.0)
    assert main(["replay", "last", "--decide", "--logs", str(seen.request.logs)]) == 2
    text = capsys.readouterr().out
    assert "ANOTHER DECISION at 1.00 s, state preparing, effect prepare" in text
    assert "then   a set-point for the arms" in text and "now    a reading of the clock" in text


def test_a_changed_figure_in_the_journal_alone_is_reported(seen: Any) -> None:
    entries = list(seen.entries)
    at = next(i for i, e in enumerate(entries) if (e.kind, e.name) == ("result", "recognise"))
    payload = {**entries[at].payload, "confidence": 0.125}
    entries[at] = replace(entries[at], payload=payload)
    there = decide_again(seen.record, entries, (Enough("recognise"),)).deviation
    assert there is not None and there.place == f"line {at + 1} of the journal"
    assert "confidence 0.125" in there.then and "confidence 0." in there.now


class Enough:
    """An observer that ends the replay after one effect."""

    def __init__(self, effect: str) -> None:
        self._effect = effect

    def entered(self, t: float, step: Any) -> None: ...

    def performed(self, t: float, step: Any, result: Any) -> None:
        if step.effect.value == self._effect:
            raise NoRecordedAnswer("enough", "enough")


# missing files


def test_replay_without_the_pictures_is_a_storage_error(seen: Any, copied: JournalRun) -> None:
    shutil.rmtree(copied.directory / FRAMES)
    with pytest.raises(StorageError, match="missing or damaged"):
        decided(seen, copied)


def test_replay_without_the_transcript_is_a_storage_error(seen: Any, copied: JournalRun) -> None:
    (copied.directory / TRANSCRIPT).unlink()
    with pytest.raises(StorageError, match="has no transcript"):
        decided(seen, copied)


def test_replay_without_the_request_is_a_configuration_error(seen: Any, copied: JournalRun) -> None:
    (copied.directory / "request.json").unlink()
    with pytest.raises(ConfigurationError, match="the request of the run"):
        decided(seen, copied)


def test_replay_with_invalid_settings_is_a_configuration_error(seen: Any, copied: JournalRun) -> None:
    path = copied.directory / "cell.yaml"
    path.write_text(path.read_text(encoding="utf-8") + "oven: hot\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="oven"):
        decided(seen, copied)
