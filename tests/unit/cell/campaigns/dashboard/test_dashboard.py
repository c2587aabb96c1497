"""The dashboard over a real socket: access, files, filters, damaged runs, two runs side by side."""

from __future__ import annotations

import http.client
import re
import socket
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from html import unescape
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

import pytest

from foldcell.cell.campaigns.dashboard.server import served_history
from foldcell.cell.campaigns.trials.campaign import TrialRequest
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import Trial, write_trial
from foldcell.cell.journal.journal import Journal
from foldcell.cell.operator.local_server import open_listener
from foldcell.cell.record.run_record import FoldRecord, RunResult, write_record
from foldcell.robots.errors import FailureKind
from tests.builders.campaigns import record, trials_campaign
from tests.builders.records import score_record
from tests.inspections import a_claim

TOO_HIGH: dict[str, Any] = {"failure": FailureKind.TOO_HIGH, "what": "folded, but stands 31 mm high"}


@dataclass(frozen=True)
class Dashboard:
    logs: Path
    address: str

    def get(self, path: str = "", **query: str) -> str:
        with urllib.request.urlopen(self.address + path + (f"?{urlencode(query)}" if query else "")) as answer:
            return unescape(answer.read().decode())

    def status(self, path: str, host: str | None = None) -> int:
        """The status of a path below the secret, which is sent exactly as it is written here."""
        parts = urlsplit(self.address)
        link = http.client.HTTPConnection(parts.netloc, timeout=10)
        link.request("GET", parts.path + path, headers={"Host": host or parts.netloc})
        status = link.getresponse().status
        link.close()
        return status


@pytest.fixture
def dashboard(tmp_path: Path) -> Iterator[Dashboard]:
    logs = tmp_path / "logs"
    logs.mkdir()
    with served_history(logs, open_listener()) as address:
        yield Dashboard(logs, address)


@pytest.fixture(autouse=True)
def never_too_old(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tests change the folder faster than a cell does."""
    monkeypatch.setattr("foldcell.cell.campaigns.dashboard.history.LEAST_AGE_S", -1.0)


def performed(
    logs: Path, garment: str = "towel", seed: int = 1, result: RunResult = "folded", **values: Any
) -> Path:
    """Journal a run that looked and grasped, with settings, a report and a picture. Returns its folder."""
    with Journal.open(logs / "journal.db") as journal:
        run = journal.begin_run(garment=garment, seed=seed, driver="sim", versions={"numpy": "2"})
        for t, effect in enumerate(("look", "grasp")):
            run.result(run.intent(float(t), "working", effect), t + 0.5, {"event": "done"})
        ended = record(result, garment=garment, seed=seed, run_dir=str(run.directory), **values)
        run.end(result, ended.as_json())
    (run.directory / "cell.yaml").write_text(f"grasp: {{grip_force: {10.0 + seed}}}\n")
    (run.directory / "report.html").write_text(f"the report of seed {seed}")
    (run.directory / "last.jpg").write_bytes(b"\xff\xd8 seed %d" % seed)
    return run.directory


def trial_of(campaign: CampaignFolder, request: TrialRequest, **values: Any) -> Path:
    """Perform a run of a campaign: journalled in its own folder, with its result beside."""
    folder = campaign.folder(request)
    folder.mkdir(parents=True)
    run = performed(folder, request.garment, request.seed, **values)
    given = {"garment": request.garment, "seed": request.seed, "run_dir": str(run), **values}
    write_trial(folder, Trial(request, record(**given)))
    return run


def rows(text: str) -> list[str]:
    table = text[text.index('<table id="runs">') :]
    return re.findall(r"<tr.*?</tr>", table[table.index("<tbody>") :], flags=re.S)


def links(text: str) -> list[str]:
    return re.findall(r'(?:href|src)="([^"]+)"', text)


def test_a_garment_given_as_a_file_is_shown_by_its_name(dashboard: Dashboard) -> None:
    """A resumed run has another file, a copy in the folder of the first run."""
    files = ["/home/anyone/my_shirt.yaml", "/logs/a/garment/my_shirt.yaml"]
    performed(dashboard.logs)
    for seed, file in enumerate(files):
        performed(dashboard.logs, file, seed)
    first, second, _ = rows(dashboard.get())
    assert f'<span title="{files[1]}">my shirt</span>, seed 1' in first
    assert f'<span title="{files[0]}">my shirt</span>, seed 0' in second
    assert len(rows(dashboard.get(garment="my_shirt"))) == 2


# access


def test_the_address_has_a_secret_and_the_page_loads_nothing_from_elsewhere(dashboard: Dashboard) -> None:
    performed(dashboard.logs)
    origin = "/".join(dashboard.address.split("/")[:3])
    for path in ("/", "/x/", "/runs", "/files/journal.db"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(origin + path)
    with urllib.request.urlopen(dashboard.address) as answer:
        policy, text = answer.headers["Content-Security-Policy"], answer.read().decode()
        assert answer.headers["Referrer-Policy"] == "no-referrer" and answer.headers["X-Frame-Options"] == "DENY"
    assert "default-src 'none'" in policy and "script-src" not in policy
    assert "<script" not in text and all(link.startswith(("./", "files/", "compare?")) for link in links(text))


def test_other_host_names_are_refused(dashboard: Dashboard) -> None:
    """A page of another site whose name is made to point here cannot read the answers."""
    assert dashboard.status("") == 200
    assert dashboard.status("", host="evil.example") == 400


def test_the_page_is_served_on_this_machine_only(dashboard: Dashboard) -> None:
    port = urlsplit(dashboard.address).port
    assert port is not None
    with socket.socket() as other:
        other.settimeout(2.0)
        assert other.connect_ex(("127.0.0.2", port)) != 0


# files


def test_reports_and_pictures_are_handed_out(dashboard: Dashboard) -> None:
    run = performed(dashboard.logs, seed=3)
    assert f"files/{run.name}/report.html" in dashboard.get()
    assert dashboard.get(f"files/{run.name}/report.html") == "the report of seed 3"
    with urllib.request.urlopen(dashboard.address + f"files/{run.name}/last.jpg") as answer:
        assert answer.headers["Content-Type"] == "image/jpeg" and answer.read().endswith(b"seed 3")
        assert "script-src" not in answer.headers["Content-Security-Policy"]


@pytest.mark.parametrize(
    "path",
    [
        "../secret.html", "RUN/../../secret.html", "%2e%2e/secret.html", "..%2fsecret.html", "/secret.html",
        "%2Fetc%2Fpasswd", "/etc/passwd", "OUTSIDE", "RUN/link.html", "link/secret.html", "RUN/none.html",
        "RUN", "", "RUN/%00.html", "RUN/report.html%00", "journal.db", "RUN/cell.yaml", ".hidden/report.html",
    ],
)  # fmt: skip
def test_nothing_else_is_handed_out(dashboard: Dashboard, path: str) -> None:
    run = performed(dashboard.logs)
    outside = dashboard.logs.parent / "secret.html"
    outside.write_text("outside")
    (run / "link.html").symlink_to(outside)
    (dashboard.logs / "link").symlink_to(outside.parent)
    (dashboard.logs / ".hidden").mkdir()
    (dashboard.logs / ".hidden" / "report.html").write_text("hidden")
    wanted = path.replace("RUN", run.name).replace("OUTSIDE", quote(str(outside)))
    assert dashboard.status(f"files/{wanted}") in (400, 404)


def test_nothing_in_the_folder_is_changed(dashboard: Dashboard) -> None:
    first, second = performed(dashboard.logs, seed=1), performed(dashboard.logs, seed=2)
    campaign = CampaignFolder.create(new(dashboard.logs / "trials-1"), trials_campaign([1]), dashboard.logs)
    trial_of(campaign, campaign.campaign.requests[0])

    def content() -> dict[str, tuple[int, bytes]]:
        files = (p for p in sorted(dashboard.logs.rglob("*")) if p.is_file())
        return {str(p): (p.stat().st_mtime_ns, p.read_bytes()) for p in files}

    before = content()
    dashboard.get()
    dashboard.get("compare", first=first.name, second=second.name)
    assert content() == before


def new(folder: Path) -> Path:
    folder.mkdir()
    return folder


# the list


def test_runs_are_filtered_by_garment_result_failure_campaign_and_text(dashboard: Dashboard) -> None:
    performed(dashboard.logs, "medium_towel", 1)
    performed(dashboard.logs, "medium_towel", 2, "not_folded", **TOO_HIGH)
    performed(dashboard.logs, "pants", 3, "fault", failure=FailureKind.DROPPED_CORNER, what="it fell")
    performed(dashboard.logs, "pants", 4, passed=False)
    campaign = CampaignFolder.create(new(dashboard.logs / "trials-1"), trials_campaign([5]), dashboard.logs)
    trial_of(campaign, campaign.campaign.requests[0])

    def seeds(**query: str) -> set[int]:
        return {int(s) for row in rows(dashboard.get(**query)) for s in re.findall(r"<td>[^<]*, seed (\d)", row)}

    assert seeds() == {1, 2, 3, 4, 5}
    assert seeds(garment="medium_towel") == {1, 2}
    assert seeds(result="not_folded") == {2}
    assert seeds(result="folded") == {1, 5} and seeds(result="false claim") == {4}, "a false claim is no fold"
    assert seeds(failure="too_high") == {2}
    assert seeds(campaign="trials-1") == {5} and seeds(campaign="-") == {1, 2, 3, 4}
    assert seeds(text="31 MM") == {2} and seeds(text="seed 3") == {3} and seeds(text="pants dropped_corner") == {3}
    assert seeds(garment="pants", result="fault", text="fell") == {3}
    assert seeds(garment="medium_towel", result="fault") == set()
    assert "No run meets all conditions" in dashboard.get(garment="medium_towel", result="fault")


def test_each_result_states_how_many_runs_meet_the_other_conditions(dashboard: Dashboard) -> None:
    for seed in (1, 2, 3):
        performed(dashboard.logs, "pants", seed, "not_folded", **TOO_HIGH)
    performed(dashboard.logs, "pants", 4)
    performed(dashboard.logs, "skirt", 5)
    text = dashboard.get(garment="pants", result="folded")
    assert "not folded 3</a>" in text and "folded 1</a>" in text and len(rows(text)) == 1


def test_many_runs_are_shown_in_pages(dashboard: Dashboard) -> None:
    with Journal.open(dashboard.logs / "journal.db") as journal:
        for seed in range(120):
            journal.begin_run(garment="towel", seed=seed, driver="sim", wall_clock=partial(float, 1e9 + seed)).end(
                "folded"
            )
    shown = []
    for page in ("1", "2", "3"):
        text = dashboard.get(page=page)
        assert f"page {page} of 3" in text
        shown += [int(s) for row in rows(text) for s in re.findall(r"seed (\d+)", row)[:1]]
    assert shown == list(range(119, -1, -1)), "each run once, the newest first"
    for page in ("0", "99", "-1", "x", "9" * 40):
        assert len(rows(dashboard.get(page=page))) in (50, 20)


def test_the_campaigns_are_listed_with_their_pages(dashboard: Dashboard) -> None:
    plan = trials_campaign([1, 2, 3])
    campaign = CampaignFolder.create(new(dashboard.logs / "trials-1"), plan, dashboard.logs)
    passed, failed, _ = campaign.campaign.requests
    run = trial_of(campaign, passed)
    trial_of(campaign, failed, passed=False, result="not_folded", **TOO_HIGH)
    for page in ("campaign.html", "faults.html"):
        (campaign.path / page).write_text(f"this is {page}")
    text = dashboard.get()
    assert "2 of 3" in text and re.search(r'class="number">1</td>', text), (
        "of three runs two are finished, one folded"
    )
    for page in ("campaign.html", "faults.html"):
        assert f"files/trials-1/{page}" in links(text)
        assert dashboard.get(f"files/trials-1/{page}") == f"this is {page}"
    report = f"files/{run.relative_to(dashboard.logs).as_posix()}/report.html"
    assert report in links(text) and dashboard.get(report) == "the report of seed 1"


def test_scripted_runs_and_runs_that_go_on_are_listed(dashboard: Dashboard) -> None:
    scripted = new(dashboard.logs / "hil-20261126T011204Z")
    performed(scripted, seed=7)
    with Journal.open(dashboard.logs / "journal.db") as journal:
        run = journal.begin_run(garment="towel", seed=8, driver="sim")
        run.intent(1.0, "folding", "fold")
        (row,) = rows(dashboard.get(result="running"))
        assert "seed 8" in row
        run.end("folded", record().as_json())
        assert not re.search("running</span>", dashboard.get()), "the page shows the end at once"
    assert "scripted runs" in dashboard.get() and len(rows(dashboard.get(campaign=scripted.name))) == 1


def test_texts_of_runs_cannot_become_part_of_the_page(dashboard: Dashboard) -> None:
    attack = "<script>alert(1)</script>"
    runs = [
        performed(dashboard.logs, attack, seed, "fault", failure=FailureKind.SLIPPED, what=f'"{attack}')
        for seed in (1, 2)
    ]
    for address in (
        dashboard.address,
        f"{dashboard.address}?{urlencode({'text': attack, 'garment': attack})}",
        f"{dashboard.address}compare?{urlencode({'first': runs[0].name, 'second': runs[1].name})}",
    ):
        with urllib.request.urlopen(address) as answer:
            assert b"<script" not in answer.read()


# damage


def test_damaged_runs_and_campaigns_are_shown_as_damaged_beside_the_others(dashboard: Dashboard) -> None:
    performed(dashboard.logs, seed=1)
    lost = performed(dashboard.logs, seed=2)
    for path in sorted(lost.iterdir()):
        path.unlink()
    lost.rmdir()
    for name, text in (
        ("20261126T000000Z-towel-seed3", '{"garment": "towel", "seed": 3'),
        ("20261126T000001Z-towel-seed4", '{"failure": [], "score": 5, "steps": "no", "seed": "x"}'),
    ):
        (new(dashboard.logs / name) / "result.json").write_text(text)  # fmt: skip
    (new(dashboard.logs / "trials-broken") / "campaign.json").write_text('{"schema": 1')
    campaign = CampaignFolder.create(new(dashboard.logs / "trials-1"), trials_campaign([6]), dashboard.logs)
    run = trial_of(campaign, campaign.campaign.requests[0])
    (run.parent / "trial.json").write_text("{")
    text = dashboard.get()
    assert len(rows(text)) == 5
    assert "trial.json is damaged" in text and re.search(
        r"trials-broken.*campaign\.json cannot be read", text, re.S
    )
    damaged = rows(dashboard.get(result="damaged"))
    assert len(damaged) == 3 and sum("its folder is missing" in row for row in damaged) == 1
    assert len(rows(dashboard.get(result="folded"))) == 3, "seeds 1 and 2, and 6 from its journal"
    names = [row.name for row in (dashboard.logs / "20261126T000000Z-towel-seed3", lost, run)]
    text = dashboard.get("compare", first=names[0], second="20261126T000001Z-towel-seed4")
    assert "damaged" in text and "the journal does not tell its decisions" in text


@pytest.mark.parametrize("content", [b"", b"no database", b"SQLite format 3\x00" + b"\xff" * 4096])
def test_a_damaged_journal_hides_neither_its_runs_nor_campaigns(dashboard: Dashboard, content: bytes) -> None:
    run = performed(dashboard.logs, seed=1)
    write_record(record(run_dir=str(run)))
    campaign = CampaignFolder.create(new(dashboard.logs / "trials-1"), trials_campaign([6]), dashboard.logs)
    trial_of(campaign, campaign.campaign.requests[0])
    for path in dashboard.logs.glob("journal.db*"):
        path.unlink()
    (dashboard.logs / "journal.db").write_bytes(content)
    text = dashboard.get()
    assert 'class="notice"' in text and "journal.db" in text
    assert "the journal has no such run; its result.json says folded" in text
    assert len(rows(text)) == 2 and f"files/{run.name}/report.html" in links(text)


def test_simulated_runs_are_labelled(dashboard: Dashboard) -> None:
    with Journal.open(dashboard.logs / "journal.db") as journal:
        names = []
        for driver in ("sim", "emulator", "ros"):
            run = journal.begin_run(garment="towel", seed=None, driver=driver)
            run.end("folded", record(passed=None, driver=driver, simulated=driver != "ros").as_json())
            names.append(run.id)
    labels = {
        name: "simulated" in row for row in rows(dashboard.get()) for name in names if f'title="{name}"' in row
    }
    assert labels == dict(zip(names, (True, True, False), strict=True))
    assert dashboard.get("compare", first=names[0], second=names[2]).count("(simulated)") == 1


def test_an_empty_folder_says_so(dashboard: Dashboard) -> None:
    assert "no runs in this folder yet" in dashboard.get()


# two runs side by side


def test_two_runs_are_shown_side_by_side(dashboard: Dashboard) -> None:
    score = score_record({"iou": 0.90, "height_m": 0.022}, passed=False, iou=0.85, height_m=0.031)
    claim = replace(a_claim(), flat=False, reliability=0.97, says="folded, but high")
    fold = FoldRecord("half", True, True, attempts=2, recoveries=("missed_grasp -> grasp_again",))
    a = performed(dashboard.logs, seed=1)
    b = performed(dashboard.logs, seed=2, result="not_folded", score=score, claim=claim, steps=(fold,), **TOO_HIGH)
    (a / "questions").mkdir()
    (a / "questions" / "01-awaiting_approval.jpg").write_bytes(b"\xff\xd8")
    (b / "fold.png").write_bytes(b"png")
    text = dashboard.get("compare", first=a.name, second=b.name)

    def cells(name: str) -> list[str]:
        found = re.search(rf"<td>{re.escape(name)}</td>(.*?)</tr>", text, flags=re.S)
        assert found is not None, name
        return re.findall(r"<td[^>]*>(.*?)</td>", found[1], flags=re.S)

    assert cells("result") == ["folded", "not folded"] and cells("seed") == ["1", "2"]
    assert cells("failure") == ["–", "too high"]
    assert cells("in words")[1] == "folded, but high" and cells("reliability")[1] == "97 %"
    assert cells("IoU")[1] == "0.850 (at least 0.900)" and "31.0 mm (at most 22.0 mm)" in text
    assert cells("1. half: grasps")[1] == "2" and "missed grasp -> grasp again" in text
    assert cells("grasp.grip_force") == ["11", "12"], "settings that differ"
    assert "All 2 decisions are the same." in text and "The versions are the same." in text
    shown = links(text)
    for picture in (a / "last.jpg", b / "last.jpg", b / "fold.png", a / "questions" / "01-awaiting_approval.jpg"):
        assert f"files/{picture.relative_to(dashboard.logs).as_posix()}" in shown
    assert f"files/{a.name}/fold.png" not in shown, "a picture that is missing is not linked"
    assert "question 1: awaiting approval" in text


def test_a_run_of_a_campaign_is_compared_with_a_run_by_itself(dashboard: Dashboard) -> None:
    campaign = CampaignFolder.create(new(dashboard.logs / "trials-1"), trials_campaign([6]), dashboard.logs)
    run = trial_of(campaign, campaign.campaign.requests[0])
    alone = performed(dashboard.logs, seed=1)
    chosen = dashboard.get(chosen=alone.name)
    (pair,) = [link for link in links(chosen) if link.startswith("compare?")]
    text = dashboard.get(pair)
    assert run.relative_to(dashboard.logs).as_posix() in text and "decisions are the same" in text


@pytest.mark.parametrize("names", [{}, {"first": "RUN"}, {"first": "RUN", "second": "../logs/RUN"},
                                   {"first": "none", "second": "RUN"}])  # fmt: skip
def test_runs_that_do_not_exist_cannot_be_compared(dashboard: Dashboard, names: dict[str, str]) -> None:
    run = performed(dashboard.logs)
    query = urlencode({k: v.replace("RUN", run.name) for k, v in names.items()})
    with pytest.raises(urllib.error.HTTPError, match="404") as refused:
        urllib.request.urlopen(f"{dashboard.address}compare?{query}")
    assert "cannot be compared" in refused.value.read().decode()
