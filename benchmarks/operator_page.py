"""Measures the operator's page in a browser, on a loaded machine, and writes docs/results/operator.md.

    python -m benchmarks.operator_page [GARMENT] [--seed 5] [--spinning 2] [--presses 500] [--pairs 1] [--logs DIR]

Chromium (without a window) opens the real page of real supervised runs while processes spin on all processors:

- a supervised run, each question approved as soon as that is possible: the age of the picture on the screen,
  sampled ten times a second; all requests of the page; the addresses at which the run listens; the time until film
  and report are written,
- the same run without a page, for the wall time,
- a supervised run in which Pause and Resume are pressed: the time from each press until the page shows it; a
  second browser that takes control; the requests of the 3-D view.

The exit code is 0 if all figures reach their bars, else 2.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.operator.chromium import Chromium, Tab
from benchmarks.operator.supervised_run import Run, spinning, unsupervised
from benchmarks.results_page import Row, made_by, table, table_of_rows

VIEW_S = 150.0
"""Longest time until the 3-D view has started: without a graphics card it is slow [s]."""
PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "operator.md"
WATCH = """
window.watched = { ages: [], acks: [], blank: 0 };
setInterval(() => {
  if (runStatus === null || runStatus.end) return;
  if (shownTaken === null) { watched.blank += 1; return; }
  watched.ages.push([runStatus.state, Date.now() - shownTaken]);
}, 100);
document.addEventListener("click", (event) => {
  const pressed = event.timeStamp, button = event.target.closest("button");
  at("answer").dataset.old = at("answer").textContent;
  requestAnimationFrame(() => {
    // the answer of the cell may come before the frame, and then it is shown at once
    const seen = button.classList.contains("sent") || at("answer").textContent !== at("answer").dataset.old;
    const painted = new MessageChannel();
    painted.port1.onmessage = () => watched.acks.push([button.id, performance.now() - pressed, seen]);
    painted.port2.postMessage(null);
  });
}, true);
"""
APPROVABLE = """new Promise((done) => {
  const timer = setInterval(() => {
    const over = runStatus?.end != null || !alive();
    if (!over && document.getElementById("approve").disabled) return;
    clearInterval(timer);
    done(!over);
  }, 10);
})"""
MIDDLE = """(() => {
  const r = at("%s").getBoundingClientRect();
  return [r.x + r.width / 2, r.y + r.height / 2];
})()"""
ANSWERED = """new Promise((done) => {
  const timer = setInterval(() => {
    if (runStatus.question?.number === NUMBER && alive()) return;
    clearInterval(timer); done(null);
  }, 10);
})"""
ROWS = (
    Row(
        "share of samples in which the picture on the screen is at most 1 s old",
        "age_share_within_1_s",
        0.99,
        True,
    ),
    Row("age of the picture on the screen, median", "age_median_s", unit="s"),
    Row("age of the picture on the screen, 99th percentile", "age_p99_s", unit="s"),
    Row("samples of the age", "age_samples"),
    Row("presses", "presses", 500, True),
    Row("time from the press until the page shows it, median", "press_median_ms", unit="ms"),
    Row("time from the press until the page shows it, 99th percentile", "press_p99_ms", 100.0, unit="ms"),
    Row("presses that the page did not show", "presses_unseen", 0),
    Row("questions", "questions", 1, True),
    Row("requests that left the machine", "requests_outside", 0),
    Row("requests of Rerun's viewer that the browser blocked", "requests_blocked"),
    Row("addresses at which the run listens", "listening", 1),
    Row("wall time of the supervised run, without waiting for answers, over the other's", "wall_ratio", 1.05),
    Row("time from the end of the run until the report is written", "report_s", 3.0, unit="s"),
)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Measure the operator's page.")
    parser.add_argument("garment", nargs="?", default="small_towel")
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--spinning", type=int, default=2, help="processes that keep the processors busy")
    parser.add_argument("--presses", type=int, default=500)
    parser.add_argument("--pairs", type=int, default=1, help="runs with and without the page")
    parser.add_argument("--logs", type=Path, help="keep the runs and the screenshots in this folder")
    options = parser.parse_args(arguments)
    logs = options.logs or Path(tempfile.mkdtemp())
    load = [os.getloadavg()[0]]
    with spinning(options.spinning):
        figures: dict[str, Any] = {}
        ratios = []
        for k in range(options.pairs):
            alone = unsupervised(options.garment, options.seed, logs / f"alone-{k}")
            found = _supervised(options, logs / f"supervised-{k}")
            ratios.append((found.pop("wall_s"), float(alone["wall_time_s"])))
            figures |= found if k == 0 else {}
        figures |= {
            "wall_ratio": sum(with_page for with_page, _ in ratios) / sum(without for _, without in ratios),
            "walls_s": [[round(a, 1), round(b, 1)] for a, b in ratios],
        }
        load.append(os.getloadavg()[0])
        if options.presses:
            pressed = _pressed(options, logs / "pressed")
            for key in ("requests_outside", "requests_blocked"):
                pressed[key] += figures[key]
            figures |= pressed
        load.append(os.getloadavg()[0])
    figures["load"] = [round(value, 1) for value in load]
    text = _page(figures, options)
    PAGE.write_text(text, encoding="utf-8")
    print(text)
    if not options.logs:
        shutil.rmtree(logs, ignore_errors=True)
    print(json.dumps(figures))
    return 2 if "not met" in text else 0


def _supervised(options: argparse.Namespace, logs: Path) -> dict[str, Any]:
    """Perform a run whose questions are approved as soon as that is possible."""
    questions = 0
    with Chromium() as browser, ExitStack() as closing:
        run = closing.enter_context(Run(options.garment, options.seed, logs))
        tab = browser.open(run.address)
        _ready(tab)
        tab.evaluate(WATCH)
        listening = run.listening()
        while tab.evaluate(APPROVABLE):
            number = tab.evaluate("runStatus.question.number")
            questions += tab.evaluate('runStatus.state === "awaiting_approval"')
            if not tab.evaluate('at("approve").disabled'):
                tab.press(*tab.evaluate(MIDDLE % "approve"))
            tab.evaluate(ANSWERED.replace("NUMBER", str(number)))
        watched = tab.evaluate("watched")
        result = run.result()
        (logs / "watched.json").write_text(json.dumps(watched))
        ages = np.array([age for _, age in watched["ages"]]) / 1000.0
        outside, blocked = tab.outside(run.origin), tab.blocked
    report, written = (Path(result["run_dir"]) / name for name in ("report.html", "result.json"))
    return {
        "age_share_within_1_s": float(np.mean(ages <= 1.0)), "age_median_s": float(np.median(ages)),
        "age_p99_s": float(np.percentile(ages, 99)), "age_samples": len(ages), "age_blank": watched["blank"],
        "questions": questions,
        "requests_outside": len(outside), "requests_blocked": len(blocked), "outside": outside,
        "listening": len(listening), "listens_at": listening, "result": result["result"],
        "wall_s": float(result["wall_time_s"]) - run.asked_s(), "asked_s": run.asked_s(),
        "report_s": report.stat().st_mtime - written.stat().st_mtime,
    }  # fmt: skip


def _pressed(options: argparse.Namespace, logs: Path) -> dict[str, Any]:
    """Perform a run in which Pause and Resume are pressed, then hand the control over and open the 3-D view."""
    with Chromium() as browser, Chromium() as other, ExitStack() as closing:
        run = closing.enter_context(Run(options.garment, options.seed, logs))
        tab = browser.open(run.address)
        _ready(tab)
        tab.evaluate(WATCH)
        while tab.evaluate("watched.acks.length") < options.presses:
            name = tab.evaluate('["pause", "resume", "approve"].find((name) => !at(name).disabled) ?? null')
            if name is not None:
                tab.press(*tab.evaluate(MIDDLE % name))  # it may have been disabled just before
            elif tab.evaluate("runStatus?.end != null"):
                break
            time.sleep(0.1)
        watched = tab.evaluate("watched")
        second = other.open(run.address)
        _ready(second)
        hand_over = None
        if run.process.poll() is None and tab.evaluate("runStatus?.end == null"):
            began = time.monotonic()
            second.press(*second.evaluate(MIDDLE % "take"))
            tab.evaluate("""new Promise((done) => { const timer = setInterval(() => {
              if (control === "yours") return; clearInterval(timer); done(null); }, 10); })""")
            hand_over = time.monotonic() - began
        drawing = closing.enter_context(Chromium(graphics=True))
        view = drawing.open(f"{run.address}viewer/")
        deadline = time.monotonic() + VIEW_S
        while time.monotonic() < deadline and not view.evaluate("document.body?.dataset.started === 'true'"):
            time.sleep(0.5)
        time.sleep(10.0)
        (logs / "view.png").write_bytes(view.screenshot())
        started = view.evaluate("document.body.dataset.started === 'true'")
        listening = run.listening()
        outside = tab.outside(run.origin) + view.outside(run.origin) + second.outside(run.origin)
        blocked = view.blocked
        second.press(*second.evaluate(MIDDLE % "stop"))
        result = run.result()
    acks = watched["acks"]
    (logs / "acks.json").write_text(json.dumps(acks))
    times = np.array([ms for _, ms, _ in acks])
    return {
        "presses": len(times), "press_median_ms": float(np.median(times)),
        "press_p99_ms": float(np.percentile(times, 99)), "presses_unseen": sum(not seen for _, _, seen in acks),
        "hand_over_s": hand_over, "view_started": started, "requests_outside": len(outside), "outside": outside,
        "requests_blocked": len(blocked), "listening": len(listening), "listens_at": listening,
        "pressed_end": result["result"],
    }  # fmt: skip


def _ready(tab: Tab) -> None:
    """Wait until the page has received the run's status."""
    deadline = time.monotonic() + 120.0
    while not tab.evaluate("typeof runStatus !== 'undefined' && runStatus !== null"):
        if time.monotonic() > deadline:
            raise TimeoutError("the page receives nothing")
        time.sleep(0.05)


def _page(figures: dict[str, Any], options: argparse.Namespace) -> str:
    cores, load = os.cpu_count(), ", ".join(map(str, figures["load"]))
    walls = ", ".join(f"{a} s with and {b} s without the page" for a, b in figures["walls_s"])
    command = f"python -m benchmarks.operator_page {options.garment} --seed {options.seed} --pairs {options.pairs}"
    parts = [
        "# Results: the operator's page",
        f"""Simulated: {options.garment}, seed {options.seed}. A browser (Chromium, without a window) opens
the real page of real supervised runs on {cores} cores, while {options.spinning} processes spin. The load average
before, between and after the runs was {load}; more than about 5 means that other work
ran on the machine.

{made_by(command)}""",
        table_of_rows("Figures", ROWS, figures) or "",
        f"""Wall times: {walls}. The run listened at {", ".join(figures["listens_at"]) or "?"} only.
{_hand_over(figures)}
The supervised run ended as {figures["result"]}. Samples before the first picture: {figures["age_blank"]}.""",
        table("How it is measured", ("figure", "method"), METHODS),
    ]
    return "\n\n".join(parts) + "\n"


METHODS = (
    (
        "age",
        "ten times a second the page's own record: when the cell took the picture that is on the screen, or when"
        " it last looked the same; the time of a simulated cell stands still while the computer computes",
    ),
    ("press", "from the input event of the browser to the frame in which the button shows that it was pressed"),
    ("requests", "all requests of the page and of the 3-D view, from the browser's network log"),
    ("listening", "`ss -ltnp` during the run, for its processes"),
    ("wall time", "`wall_time_s` of the results, less the time between question and answer in the journal"),
    ("report", "from the writing of `result.json` to that of `report.html`, with the film"),
)


def _hand_over(figures: dict[str, Any]) -> str:
    seconds = figures.get("hand_over_s")
    return "" if seconds is None else f"A second browser took the control in {1000 * seconds:.0f} ms."


if __name__ == "__main__":
    sys.exit(main())
