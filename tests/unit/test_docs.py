"""Commands, files and links named by README.md and docs/ exist."""

from __future__ import annotations

import argparse
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from foldcell.cell.campaigns.hil.script import read_script
from foldcell.cell.commands.main import build_parser
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import list_garments
from foldcell.cell.control import rest, ticks
from foldcell.cell.control.checks import MAX_ALTERED
from foldcell.cell.control.motions import trajectory
from foldcell.cell.executive.effects import seeing
from foldcell.cell.executive.effects.recovery import ways_out
from foldcell.cell.hardware.cell_check import cell_findings
from foldcell.cell.states import recovery_table
from foldcell.cell.states.transition_table import Event
from foldcell.robots import setpoint
from foldcell.robots.baxter.ros import electric_gripper
from foldcell.robots.baxter.ros.ports import arms
from foldcell.robots.errors import FailureKind
from foldcell.skills.motion.timing import timing

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
ROOMS = ("cell", "skills", "robots", "calibration", "tests", "docs", "benchmarks")


def code(text: str) -> Iterator[str]:
    """All code of a page: the lines of fenced blocks without comments, and inline code."""
    parts = re.split(r"^```.*$", text, flags=re.M)
    for block in parts[1::2]:
        for line in block.splitlines():
            yield re.split(r"(?:^|\s)#", line)[0].strip().removeprefix("$ ")
    for prose in parts[0::2]:
        yield from (span.replace("\n", " ").strip() for span in re.findall(r"`([^`]+)`", prose))


def found(pattern: str) -> list[tuple[str, str]]:
    """(page, match of the pattern's group) for all code of all pages."""
    return [
        (page.name, match)
        for page in PAGES
        for line in code(page.read_text(encoding="utf-8"))
        for match in re.findall(pattern, line)
    ]


def commands() -> list[tuple[str, str]]:
    return found(r"(?:^|[\s;&/])foldcell((?: +[^\s;&|]+)+)")


def parser_of(words: list[str]) -> tuple[argparse.ArgumentParser, list[str]]:
    """The parser of the (sub)command at the beginning of `words`, and the remaining words."""
    parser = build_parser()
    while True:
        nested = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
        if not nested:
            return parser, words
        if not words or words[0] not in nested[0].choices:
            raise AssertionError(
                f"there is no command '{' '.join(words)}'; there are {', '.join(nested[0].choices)}"
            )
        parser, words = nested[0].choices[words[0]], words[1:]


def check(line: str) -> None:
    """Raises AssertionError for an invalid command line."""
    words = shlex.split(line)
    if words[0].startswith("-"):
        assert words[0] in build_parser()._option_string_actions, f"no option {words[0]}"
        return
    parser, rest = parser_of(words)
    for word in rest:
        if word.startswith("--"):
            assert word.split("=")[0] in parser._option_string_actions, f"{words[0]} has no option {word}"
    if "..." not in line and "[" not in line:
        wanted = ["1" if w == "N" else w for w in rest]
        parser.parse_args(wanted)
    if words[0] in {"fold", "supervise", "optimise"} and re.fullmatch(r"[a-z_]+", rest[0]):
        assert rest[0] in (*list_garments(), "auto"), f"no garment {rest[0]}"


def test_the_documented_pages_exist() -> None:
    assert {p.name for p in PAGES} >= {"README.md", "architecture.md", "invariants.md"}
    assert all(p.stat().st_size > 500 for p in PAGES)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_page_is_longer_than_a_reader_takes(page: Path) -> None:
    assert len(page.read_text(encoding="utf-8").splitlines()) <= 250


def test_the_readme_names_the_main_commands() -> None:
    told = " ".join(line for page, line in commands() if page == "README.md")
    assert "fold medium_towel" in told
    assert {"fold", "test"} <= {target for page, target in targets() if page == "README.md"}


@pytest.mark.parametrize(("page", "line"), commands())
def test_every_documented_command_is_valid(page: str, line: str) -> None:
    try:
        check(line)
    except SystemExit:
        raise AssertionError(f"{page}: 'foldcell {line}' is refused") from None


@pytest.mark.parametrize("line", ["dance", "fold sock", "fold medium_towel --sed 3", "garment", "--verbose"])
def test_the_check_of_commands_refuses_unknown_commands_and_options(line: str) -> None:
    with pytest.raises((AssertionError, SystemExit)):
        check(line)


def targets() -> list[tuple[str, str]]:
    return found(r"(?:^|&& *|; *)make +([a-z][a-z_-]*)")


def rules() -> set[str]:
    return set(re.findall(r"^([a-z][a-z_-]*):(?!=)", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.M))


def test_every_documented_make_target_exists() -> None:
    assert {target for _, target in targets()} - rules() == set()


def test_every_phony_target_is_defined() -> None:
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    promised = {name for line in re.findall(r"^\.PHONY:(.*)$", text, flags=re.M) for name in line.split()}
    assert promised - rules() == set()


def holders() -> list[tuple[str, str]]:
    """(beginning of the rule, path) for every test named in docs/understand/invariants.md."""
    named = []
    for line in (ROOT / "docs" / "understand" / "invariants.md").read_text(encoding="utf-8").splitlines():
        cells = [c.strip() for c in line.strip("|").split("|")]
        if not line.startswith("|") or len(cells) != 3 or cells[2].strip("-") in {"", "held by"}:
            continue
        paths = re.findall(r"`([^`]+)`", cells[2])
        assert paths, f"nothing holds '{cells[0][:40]}'"
        folder = ""
        for path in paths:  # a bare name is in the folder of the previous path
            whole = path if "/" in path else f"{folder}/{path}"
            folder = whole.rpartition("/")[0]
            named.append((cells[0][:40], whole))
    return named


@pytest.mark.parametrize(("rule", "path"), holders())
def test_files_named_by_the_invariants_exist(rule: str, path: str) -> None:
    place = ROOT / path
    assert place.is_file() or (place.is_dir() and list(place.rglob("test_*.py"))), (
        f"'{rule}...' is held by nothing"
    )


def test_each_rule_of_the_emulator_has_a_source_and_a_test_that_exists() -> None:
    page = (ROOT / "docs" / "look_up" / "emulator.md").read_text(encoding="utf-8")
    listed = page.partition("Sources:")[2].partition("The tests are in")[0]
    published = set(re.findall(r"\*\*([^*]+)\*\*", listed))
    rows = [
        [cell.strip() for cell in row.strip("|").split("|")] for row in page.splitlines() if row.startswith("|")
    ]
    rules = [row for row in rows if len(row) == 3 and "---" not in row[0] and row[2] != "test"]
    assert len(rules) > 35
    for rule, source, tests in rules:
        assert set(re.split(r", | \(|; ", source)) & published, f"'{rule}' has no source"
        held = re.findall(r"`([\w/]+\.py)::(test_\w+)`", tests)
        assert held and tests.count("::") == len(held), rule
        for path, name in held:
            file = ROOT / "tests" / "unit" / "robots" / path
            assert f"\ndef {name}(" in file.read_text(encoding="utf-8"), f"{path} has no {name}"


def test_every_file_named_in_the_docs_exists() -> None:
    rooms = "|".join(ROOMS)
    named = {path for _, path in found(rf"(?:^|\s)((?:{rooms})/[\w./-]+\.(?:py|yaml|md|json|png|html))\b")}
    assert len(named) > 5
    assert {path for path in named if not (ROOT / path).exists()} == set()


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and the site make them."""
    prose = "".join(re.split(r"^```.*?^```$", page.read_text(encoding="utf-8"), flags=re.M | re.S))
    titles = re.findall(r"^#+ (.*)$", prose, flags=re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def test_every_link_in_the_docs_has_a_target() -> None:
    broken = set()
    for page in (*PAGES, *(ROOT / f"{name}.md" for name in ("CONTRIBUTING", "CHANGELOG", "SECURITY"))):
        for link in re.findall(r"\]\(([^)\s]+)", page.read_text(encoding="utf-8")):
            path, _, anchor = link.partition("#")
            target = page.parent / path if path else page
            if re.match(r"[a-z]+:", link):
                continue
            outside = page.is_relative_to(DOCS) and not target.resolve().is_relative_to(
                DOCS.resolve()
            )  # of the site
            if outside or not target.exists() or (anchor and anchor not in anchors(target)):
                broken.add(f"{page.name}: {link}")
    assert broken == set()


def test_the_site_has_every_page_once_and_asks_nobody_for_its_files() -> None:
    site = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]
    shown: list[str] = []

    def walk(entry: object) -> None:
        if isinstance(entry, str):
            shown.append(entry)
        for part in entry.values() if isinstance(entry, dict) else entry if isinstance(entry, list) else ():
            walk(part)

    walk(site["nav"])
    assert sorted(shown) == sorted(p.relative_to(ROOT / "docs").as_posix() for p in PAGES[1:])
    assert site["theme"]["font"] is False and not site["use_directory_urls"]
    own = [*site["extra_css"], *(script["path"] for script in site["extra"]["polyfills"])]
    assert all((ROOT / "docs" / path).is_file() for path in own) and "iframe-worker" in own[-1]


def test_the_files_of_the_first_hour_are_valid(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "learn" / "first_hour.md").read_text(encoding="utf-8")
    cell, script = (tmp_path / name for name in ("mine.yaml", "pause.yaml"))
    for file, text in zip(
        (cell, script), re.findall(r"^```yaml\n(.*?)^```$", page, flags=re.M | re.S), strict=True
    ):
        file.write_text(text, encoding="utf-8")
    assert [finding.name for finding in cell_findings(load_settings(cell)) if not finding.good] == []
    assert [action.say for action in read_script(script).do] == [Event.PAUSE, Event.RESUME]


def test_the_safety_page_states_the_figures_of_the_cell() -> None:
    """People stand beside the arms and rely on these figures."""
    shipped, strayed = load_settings(), recovery_table.LAYING[FailureKind.TRACKING_ERROR]
    told = {
        "0.2 s and the brake": arms.COMMAND_TIMEOUT == 0.2,
        "not been heard of for 0.2 s": arms.COMMAND_TIMEOUT == 0.2,
        "one tick, 10 ms": ticks.TICK_S == 0.010,
        "on the path 0.6 s more": timing.STOP_TIME == 0.6,
        "`motion.max_state_age_s`, 0.1 s": shipped.motion.max_state_age_s == 0.1,
        "0.002 rad off": MAX_ALTERED == 0.002,
        "no further from the last one than the joints go in 40 ms at full speed": setpoint.JUMP_TIME == 0.040,
        "After a stall of more than 50 ms the arms have come to rest": ticks.STALL_S == 0.050,
        "more than 0.04 rad beside the path": trajectory.OFF_PATH == 0.04,
        "by less than 0.004 rad in 0.25 s": (rest.STILL_RAD, rest.STILL_S) == (0.004, 0.25),
        "in 0.25 s, for at most 3 s": rest.REST_S == 3.0,
        "the cell waits 2 s and clears once more": ways_out.CLEARING_DWELL_S == 2.0,
        "A motion that fails is tried three times": ways_out.LAYING[0].tries == 3,
        "(something may stand ahead) | on to the target from 90 %": strayed.all_hold == 0.9,
        "from 90 % of the path, else back | the same |": strayed.some_hold == strayed.all_hold,
        "the abort | on to the target from 50 %, else back": recovery_table.LayingRule().all_hold == 0.5,
        "| on to the target from 80 %, else back |": recovery_table.LayingRule().some_hold == 0.8,
        "One of more than 2 s in the middle of a motion": ticks.LOST_S == 2.0,
        "`grasp.press_force` (25 N as shipped)": shipped.grasp.press_force == 25.0,
        "`pressing.force` (20 N)": shipped.pressing.force == 20.0,
        "(100 % taken as 30 N)": electric_gripper.FULL_FORCE == 30.0,
        "`motion.tracking_tolerance`, 0.12 rad": shipped.motion.tracking_tolerance == 0.12,
        "to within 0.01 rad of where the camera was calibrated": seeing.HEAD_TOLERANCE == 0.01,
    }
    page = " ".join((ROOT / "docs" / "do" / "safety.md").read_text(encoding="utf-8").split())
    assert [words for words, holds in told.items() if words not in page or not holds] == []
    assert load_settings().motion.max_state_age_s <= arms.COMMAND_TIMEOUT
