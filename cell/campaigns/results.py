"""The results of a campaign so far: the figures of each variant, its comparison with the first variant, and all
runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from foldcell.cell.campaigns.statistics.comparison import Comparison, compare_trials
from foldcell.cell.campaigns.statistics.summary import Claims, Row, claims, part_claims, summarise
from foldcell.cell.campaigns.trials.campaign import Campaign
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.support.json_values import to_json

RESULTS = "trials.json"
SCHEMA = 2


@dataclass(frozen=True)
class VariantResults:
    """The results of one variant. about: the variant's difference in words. rows: one per garment. claims: counts
    of claims against verdicts. part_claims: the same counts for each part of the claim."""

    name: str
    about: str
    trials: Sequence[Trial]
    rows: Sequence[Row]
    claims: Claims
    part_claims: Mapping[str, Claims]


@dataclass(frozen=True)
class CampaignResults:
    """The results of a campaign so far. trials: the performed runs, in order of variant, garment and seed.
    not_performed: planned runs whose worker process died or could not start them, or whose robot did not start.
    comparisons: the comparison of each other variant with the first, as (name of the first, name of the other,
    comparison)."""

    campaign: Campaign
    trials: Sequence[Trial]
    not_performed: Sequence[Trial]
    variants: Sequence[VariantResults]
    comparisons: Sequence[tuple[str, str, Comparison]]

    @classmethod
    def of(cls, campaign: Campaign, trials: Sequence[Trial]) -> CampaignResults:
        performed = sorted((t for t in trials if t.performed), key=lambda t: t.request.key)
        groups = {name: [t for t in performed if t.request.variant == name] for name in campaign.variants}
        first, *others = groups
        return cls(
            campaign,
            performed,
            [t for t in trials if not t.performed],
            [
                VariantResults(
                    name, campaign.variants[name], group, summarise(group), claims(group), part_claims(group)
                )
                for name, group in groups.items()
            ],
            [(first, other, compare_trials(groups[first], groups[other])) for other in others],
        )

    def as_json(self) -> dict[str, Any]:
        """Return the content of `trials.json`. Its key `not_performed` lists all planned runs that are not among
        `trials`."""
        done = {trial.request.key for trial in self.trials}
        values = {
            "schema": SCHEMA,
            "about": self.campaign.about,
            "label": self.campaign.label,
            "garments": [row for variant in self.variants for row in variant.rows],
            "claims": {
                v.name: {**_table(v.claims), "parts": {name: _table(t) for name, t in v.part_claims.items()}}
                for v in self.variants
            },
            "comparisons": [
                {"first": first, "second": second, **asdict(comparison)}
                for first, second, comparison in self.comparisons
            ],
            "runs": [_run(trial) for trial in self.trials],
            "not_performed": [
                {"variant": r.variant, "garment": r.garment, "seed": r.seed}
                for r in sorted(self.campaign.requests, key=lambda r: r.key)
                if r.key not in done
            ],
        }
        return dict(to_json(values))


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
        "record": trial.record,
        "scripted": trial.seen,
        "judgement": trial.judgement,
    }
