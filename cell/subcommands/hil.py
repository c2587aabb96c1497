"""`foldcell hil`: scripted runs, each held to what its script expects."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from cell.config import load_settings
from cell.hil.junit import junit_text
from cell.hil.performing import Performance, check_script, perform_script
from cell.hil.script import Script, read_script
from cell.journal import to_json
from cell.paths import campaign_folder, logs_directory, prepare_logs
from cell.subcommands.output import print_json, progress_stream
from cell.whole_file import write_whole
from robots.errors import ConfigurationError

__all__ = ["run"]

INTERRUPTED = 128


def run(options: argparse.Namespace) -> int:
    """0 when every script passed, 2 when one did not, 3 when a cell came to a fault that was not expected.

    All scripts are read and checked before the first run begins. A signal ends the run under way, and no other
    begins: what was not performed is told."""
    settings = load_settings(options.cell)
    scripts = [read_script(path) for path in _files(options.scripts)]
    for script in scripts:
        check_script(script, settings, options.driver)
    campaign = campaign_folder(prepare_logs(logs_directory(options.logs)), "hil")
    out = progress_stream(options.json)
    done: list[Performance] = []
    signal: int | None = None
    for number, script in enumerate(scripts, 1):
        _tell(out, f"{number:3d}/{len(scripts)}  {script.name}: {script.about}")
        performance = perform_script(
            script, settings, campaign, driver=options.driver, world=options.world, live=options.live,
            realtime=options.realtime, tell=lambda line: _tell(sys.stderr, f"         -> {line}"),
        )  # fmt: skip
        done.append(performance)
        _tell(out, _outcome(performance))
        signal = performance.result.signal if performance.result else None
        if signal is not None:
            break
    left = scripts[len(done) :]
    figures = _figures(done, left, options.driver)
    write_whole(campaign / "hil.json", json.dumps(to_json(figures), indent=1) + "\n")
    if options.junit is not None:
        write_whole(options.junit, junit_text(done))
    if options.json:
        print_json({**figures, "directory": str(campaign)})
    else:
        _summary(done, left, campaign)
    if signal is not None:
        return INTERRUPTED + signal
    return 3 if any(p.faulty for p in done) else 2 if any(not p.passed for p in done) else 0


def _files(given: list[Path]) -> list[Path]:
    """The scripts, and those in the folders, that were named."""
    files: list[Path] = []
    for path in given:
        inside = sorted(p for p in path.iterdir() if p.suffix in (".yaml", ".yml")) if path.is_dir() else [path]
        if not inside:
            raise ConfigurationError(f"{path} holds no script", "scripts are YAML files; see docs/operating.md")
        files += inside
    return files


def _figures(done: list[Performance], left: list[Script], driver: str) -> dict[str, Any]:
    return {
        "schema": 1,
        "simulated": driver == "sim",
        "passed": sum(p.passed for p in done),
        "failed": sum(not p.passed for p in done),
        "not_performed": [str(script.path) for script in left],
        "scripts": [p.as_json() for p in done],
    }


def _tell(stream: Any, line: str) -> None:
    print(line, file=stream, flush=True)


def _outcome(p: Performance) -> str:
    times = f"{p.result.robot_time_s:.1f} s robot, {p.seconds:.1f} s wall" if p.result else "no run"
    lines = [f"         {'passed' if p.passed else 'FAILED'}  ({times})"]
    lines += [f"         - {what}" for what in p.broken]
    if p.broken and p.result:
        lines.append(f"         {p.result.run_dir}/report.html")
    return "\n".join(lines)


def _summary(done: list[Performance], left: list[Script], campaign: Path) -> None:
    failed = [p.script.name for p in done if not p.passed]
    print(f"\n{len(done) - len(failed)} of {len(done)} passed" + (f"; not: {', '.join(failed)}" if failed else ""))
    if left:
        print(f"not performed: {', '.join(script.name for script in left)}")
    print(f"details  {campaign / 'hil.json'}")
