"""The results of a campaign as one JSON object: `trials.json` and `foldcell trials --json`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from cell.campaigns.statistics.comparison import compare_trials
from cell.campaigns.statistics.summary import Claims, claims, part_claims, summarise
from cell.campaigns.trials.campaign import Campaign
from cell.campaigns.trials.trial import Trial
from cell.support.json_values import to_json

__all__ = ["RESULTS", "campaign_results", "results_text"]

RESULTS = "trials.json"
SCHEMA = 1


def campaign_results(campaign: Campaign, trials: Sequence[Trial]) -> dict[str, Any]:
    """Return the results so far. garments: one row per variant and garment; claims: one 2 x 2 table per variant,
    and in `parts` one per part of the claim; comparisons: each variant against the first; not_performed: the
    planned runs that have no figures yet."""
    performed = sorted((t for t in trials if t.performed), key=lambda t: t.request.key)
    done = {t.request.key for t in performed}
    by_variant = {name: [t for t in performed if t.request.variant == name] for name in campaign.variants}
    first, *others = campaign.variants
    return {
        "schema": SCHEMA,
        "about": campaign.about,
        "garments": [asdict(row) for group in by_variant.values() for row in summarise(group)],
        "claims": {
            name: {
                **_table(claims(group)),
                "parts": {part: _table(table) for part, table in part_claims(group).items()},
            }
            for name, group in by_variant.items()
        },
        "comparisons": [
            {"first": first, "second": other, **asdict(compare_trials(by_variant[first], by_variant[other]))}
            for other in others
        ],
        "runs": [_run(t) for t in performed],
        "not_performed": [
            {"variant": r.variant, "garment": r.garment, "seed": r.seed}
            for r in sorted(campaign.requests, key=lambda r: r.key)
            if r.key not in done
        ],
    }


def results_text(results: dict[str, Any]) -> str:
    return json.dumps(to_json(results), indent=1) + "\n"


def _table(table: Claims) -> dict[str, Any]:
    return {**asdict(table), "precision": table.precision, "recall": table.recall}


def _run(trial: Trial) -> dict[str, Any]:
    return {
        "variant": trial.request.variant,
        "garment": trial.request.garment,
        "seed": trial.request.seed,
        "success": trial.success,
        "result": trial.result,
        "cause": trial.cause,
        "error": trial.error,
        "figures": trial.figures,
    }
