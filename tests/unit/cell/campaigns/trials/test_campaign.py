"""Campaign files: requests of every garment, seed and variant; errors name file, line and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from foldcell.cell.campaigns.trials.campaign import read_campaign
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import shipped_garment_path
from foldcell.robots.errors import ConfigurationError

SHIPPED = sorted((Path(__file__).parents[5] / "benchmarks" / "campaigns").glob("*.yaml"))


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "campaign.yaml"
    path.write_text(text)
    return path


def test_every_garment_has_a_run_with_every_seed_and_variant(tmp_path: Path) -> None:
    text = """
garments: [small_towel, medium_towel]
seeds: [7, 3]
variants:
  shipped:
  no_pressing: {cell: {pressing: {max_attempts: 0}}}
  towels_only: {garments: [small_towel], world: mujoco}
"""
    campaign = read_campaign(written(tmp_path, text), load_settings())
    keys = [request.key for request in campaign.requests]
    assert len(keys) == len(set(keys)) == 2 * (2 + 2 + 1)
    assert [seed for _, _, seed in keys] == [7] * 5 + [3] * 5, "an unfinished campaign has whole seeds"
    by_variant = {r.variant: r for r in campaign.requests}
    assert by_variant["no_pressing"].settings["pressing"]["max_attempts"] == 0
    assert by_variant["shipped"].settings["pressing"]["max_attempts"] > 0
    assert by_variant["towels_only"].world == "mujoco" and by_variant["shipped"].world == "xpbd"
    assert len({request.folder for request in campaign.requests}) == len(keys)


def test_repeated_garments_and_seeds_count_once(tmp_path: Path) -> None:
    """The same run again is no further evidence: the interval would be too narrow."""
    text = "garments: [small_towel, small_towel]\nseeds: [1, 2, 1]\n"
    assert len(read_campaign(written(tmp_path, text), load_settings()).requests) == 2


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("seeds: [1]\ngarments: [sock]\n", ["sock"]),
        ("seeds: []\n", [":1", "seeds"]),
        ("seeds: {first: 1}\n", [":1", "give {first, count}, or a list"]),
        ("seeds: {first: 1, cuont: 2}\n", ["seeds.cuont", "did you mean 'count'"]),
        ("seeds: 5\n", [":1", "seeds"]),
        ("garments: 3\nseeds: [1]\n", [":1", "garments"]),
        ("garments: []\nseeds: [1]\n", [":1", "garments"]),
        ("seeds: [1]\nkeep: some\n", [":2", "keep", "failures"]),
        ("seeds: [true]\n", [":1", "seeds"]),
        ("seeds: [1]\nvariants:\n  a:\n    cell:\n      pressing: {tries: 1}\n", [":5", "tries", "max_attempts"]),
        ("seeds: [1]\nvariants:\n  a: {cell: {table: {height: 820}}}\n", [":3", "table.height"]),
        ("seeds: [1]\nvariants:\n  a: {python: nowhere/python}\n", ["nowhere/python", "virtual environment"]),
        ("seeds: [1]\nvariants:\n  ../a: {}\n", ["variants"]),
        ("seeds: [1]\nvariants:\n  trials.json: {}\n", ["trials.json", "rename"]),
        (
            "garments: [small_towel]\nseeds: [1]\nvariants: {shipped: {}, small_towel-seed1: {}}\n",
            ["share the folder"],
        ),
        ("seeds: {first: 2147483647, count: 2}\n", ["largest seed"]),
        ("seeds: [1]\nvariants:\n  a: {do: [{fault: {kind: missed_gras}}]}\n", ["missed_grasp"]),
    ],
)
def test_errors_name_the_line_and_the_key(text: str, parts: list[str], tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError) as error:
        read_campaign(written(tmp_path, text), load_settings())
    message = f"{error.value.what} {error.value.hint}"
    assert all(part in message for part in parts), message


def test_two_garment_files_of_the_same_name_are_refused(tmp_path: Path) -> None:
    """Their runs would overwrite each other."""
    shipped = shipped_garment_path("small_towel").read_text()
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "towel.yaml").write_text(shipped)
    text = "garments: [a/towel.yaml, b/towel.yaml]\nseeds: [1]\n"
    with pytest.raises(ConfigurationError, match="share the folder towel-seed1"):
        read_campaign(written(tmp_path, text), load_settings())
    twice = written(tmp_path, "garments: [a/towel.yaml, a/../a/towel.yaml]\nseeds: [1]\n")
    (request,) = read_campaign(twice, load_settings()).requests
    assert Path(request.garment).is_absolute(), "a campaign may be continued from another folder"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_shipped_campaigns_can_be_performed(path: Path) -> None:
    campaign = read_campaign(path, load_settings())
    assert campaign.about and campaign.requests


def test_the_ablations_of_the_paper_are_shipped() -> None:
    (path,) = [p for p in SHIPPED if p.stem == "ablations"]
    variants = read_campaign(path, load_settings()).variants
    assert {"initial_arcs", "no_recovery", "no_tactile", "one_look", "no_pressing", "other_world"} <= set(variants)
