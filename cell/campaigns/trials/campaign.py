"""A campaign: garments x seeds x variants, from a YAML file or from the flags of `foldcell trials`.

about: the shipped garments, with and without pressing
garments: [medium_towel, t_shirt]       # or: all
seeds: {first: 1, count: 5}             # or a list: [7101, 7102]
keep: failures                          # recordings to keep: failures, all or none
variants:
  shipped: {}
  no_pressing:
    about: creases are not pressed
    cell: {pressing: {max_attempts: 0}}
  slip:
    do:
      - when: {state: lifting}
        fault: {kind: dropped_corner, side: left}
  yesterday: {python: ../foldcell-0.5/.venv/bin/python}
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from foldcell.cell.campaigns.hil.script import Action, Group, as_list
from foldcell.cell.config.cell_settings import CellSettings, overlaid
from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.cell.config.yaml_file import Document, read_yaml, validated
from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.record.words import garment_name
from foldcell.robots.errors import ConfigurationError

Keep = Literal["failures", "all", "none"]
MAX_SEED = 2**31 - 1
MAX_RUNS = 100_000
ALL = "all"
"""Stands in place of the garments' names for all shipped garments."""
DEFAULT_VARIANT = "shipped"
RESERVED = frozenset({"campaign.json", "campaign.html", "trials.json", "library.json", "ideal_heights.json"})
"""Files of a campaign in its folder."""


class Variant(Group):
    """The differences between one variant and the campaign's settings."""

    about: str = Field("", description="the difference in words")
    cell: dict[str, Any] = Field({}, description="settings that override those of the cell")
    do: tuple[Action, ...] = Field((), description="scripted faults and commands, as in a HIL script")
    world: Literal["xpbd", "mujoco"] | None = Field(None, description="solver of the simulated cloth")
    garments: tuple[str, ...] | None = Field(None, description="garments of this variant, if not all")
    python: str | None = Field(
        None, min_length=1, description="Python of a virtual environment with another version of foldcell"
    )

    @model_validator(mode="after")
    def _possible(self) -> Variant:
        if self.python is not None and self.do:
            raise ValueError("`do` needs this version of foldcell; it cannot be used with `python`")
        return self


_Seed = Annotated[int, Field(ge=0, le=MAX_SEED, strict=True)]


class Seeds(Group):
    """The seeds first, first + 1, ..., or a list. A file states a list directly: `seeds: [7, 3]`."""

    first: int = Field(1, ge=0, le=MAX_SEED, strict=True, description="the first seed")
    count: int | None = Field(None, ge=1, le=MAX_RUNS, strict=True, description="number of seeds")
    these: tuple[_Seed, ...] | None = Field(None, min_length=1, description="a list of seeds")

    @model_validator(mode="before")
    @classmethod
    def _from_list(cls, value: Any) -> Any:
        return {"these": value} if isinstance(value, list | tuple) else value

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.count is None) == (self.these is None):
            raise ValueError("give {first, count}, or a list of seeds")
        if self.count is not None and self.first + self.count - 1 > MAX_SEED:
            raise ValueError(f"the largest seed is {MAX_SEED}")
        return self

    @property
    def all(self) -> list[int]:
        """The seeds in order, each once."""
        if self.count is not None:
            return list(range(self.first, self.first + self.count))
        return list(dict.fromkeys(self.these or ()))


_Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_.-]{0,40}$")]


def _or_mapping(value: Any) -> Any:
    """Accept a variant with nothing after the colon as a variant without keys."""
    return {k: {} if v is None else v for k, v in value.items()} if isinstance(value, Mapping) else value


class CampaignFile(Group):
    """The content of a campaign file."""

    about: str = Field("", description="the question that the campaign answers, in one sentence")
    garments: Annotated[tuple[str, ...], BeforeValidator(as_list)] = Field(
        (ALL,), min_length=1, description="names or files, or all"
    )
    seeds: Seeds = Field(description="{first, count}, or a list of seeds")
    keep: Keep = Field("failures", description="recordings to keep: of failures, of all runs, or of none")
    variants: Annotated[dict[_Name, Variant], BeforeValidator(_or_mapping)] = Field(
        {DEFAULT_VARIANT: Variant.model_validate({})},
        min_length=1,
        description="what is compared on the same seeds",
    )


@dataclass(frozen=True)
class TrialRequest:
    """Request for one run of a campaign. Its result depends on nothing else. All values are plain JSON values.

    settings: the complete settings of the cell (for another version of foldcell: only the keys that differ from
    the shipped settings). actions: scripted faults and commands. python: Python interpreter of another version of
    foldcell; None: this version. attended: whether a person lays the garment and judges the fold.
    """

    variant: str
    garment: str
    seed: int
    driver: str
    world: str
    settings: Mapping[str, Any]
    actions: tuple[Mapping[str, Any], ...] = ()
    python: str | None = None
    attended: bool = False

    @property
    def key(self) -> tuple[str, str, int]:
        return self.variant, self.garment, self.seed

    def __str__(self) -> str:
        variant = "" if self.variant == DEFAULT_VARIANT else f", {self.variant}"
        number = "seed" if is_simulated(self.driver) else "run"
        return f"{garment_name(self.garment)}, {number} {self.seed}{variant}"

    @property
    def cell(self) -> CellSettings:
        """The complete settings of the cell of a run of this version."""
        return CellSettings.model_validate_json(json.dumps(self.settings))

    @property
    def folder(self) -> str:
        """Path of the run's folder in the campaign. It begins with the variant's name. Runs of the shipped variant
        lack this part, as in a campaign without variants."""
        name = f"{Path(self.garment).stem}-seed{self.seed}"
        return name if self.variant == DEFAULT_VARIANT else f"{self.variant}/{name}"


@dataclass(frozen=True)
class Campaign:
    """A campaign. requests: all runs, in the order in which they are started: seed by seed, so that an unfinished
    campaign has about equally many runs of each garment and variant."""

    about: str
    keep: Keep
    requests: tuple[TrialRequest, ...]
    variants: Mapping[str, str]
    """Name of each variant -> description of its difference."""

    @property
    def attended(self) -> bool:
        """Whether a person judges the folds; else the scorer judges the simulated garments."""
        return any(request.attended for request in self.requests)

    @property
    def label(self) -> str:
        """The cell of the runs, and who judges the folds if it is a person."""
        names = {"sim": "simulated", "emulator": "simulated (emulator)", "ros": "robot"}
        drivers = " and ".join(sorted({names[request.driver] for request in self.requests}))
        return f"{drivers}, judged by a person" if self.attended else drivers


def read_campaign(
    path: Path, settings: CellSettings, driver: str = "sim", world: str = "xpbd", attended: bool = False
) -> Campaign:
    """Read a campaign file. The settings of every variant and every garment are checked.

    settings: the cell's settings, which the variants override. world: cloth solver of the variants that do not
    name one. attended: whether a person lays the garments and judges the folds. Raises ConfigurationError with
    file, line, key and allowed values.
    """
    document = read_yaml(path, "campaign file")
    content = validated(document, CampaignFile)
    return campaign_of(content, settings, driver, world, attended, document)


def campaign_of(
    content: CampaignFile,
    settings: CellSettings,
    driver: str,
    world: str,
    attended: bool = False,
    document: Document | None = None,
) -> Campaign:
    """Make the campaign from validated content. document: the file, for messages and relative paths; None: the
    content comes from command-line flags.

    Raises ConfigurationError.
    """
    folder = document.path.parent if document else Path()
    of_all = distinct_garments(content.garments, folder)
    seeds = content.seeds.all
    requests = []
    for name, variant in content.variants.items():
        if attended and (variant.do or variant.python is not None):
            raise ConfigurationError(
                f"the variant {name} has scripted actions or another version of foldcell",
                "a person attends runs of this version, without a script: leave `do` and `python` out",
            )
        own = _settings(settings, name, variant, document)
        garments = of_all if variant.garments is None else distinct_garments(variant.garments, folder)
        for garment in garments:
            load_garment(garment, own.surface)
        python = None if variant.python is None else _interpreter(variant.python, folder)
        requests += [
            TrialRequest(
                name,
                garment,
                seed,
                driver,
                variant.world or world,
                variant.cell if python else own.model_dump(mode="json", by_alias=True),
                tuple(action.model_dump(mode="json", exclude_none=True) for action in variant.do),
                python,
                attended,
            )
            for garment in garments
            for seed in seeds
        ]
    if len(requests) > MAX_RUNS:
        raise ConfigurationError(f"{len(requests)} runs", f"a campaign has at most {MAX_RUNS} runs: split it")
    _check_folders(requests)
    order = {seed: n for n, seed in enumerate(seeds)}
    requests.sort(key=lambda request: order[request.seed])
    about = {name: variant.about for name, variant in content.variants.items()}
    return Campaign(content.about, content.keep, tuple(requests), about)


def _check_folders(requests: Sequence[TrialRequest]) -> None:
    """Check that each run has its own folder, outside the folders of other runs and apart from the campaign's
    files."""
    folders = Counter(request.folder for request in requests)
    double = [name for name, count in folders.items() if count > 1]
    variants = {request.variant for request in requests} - {DEFAULT_VARIANT}
    taken = sorted(variants & ({*folders} | RESERVED))
    if double or taken:
        raise ConfigurationError(
            f"two runs would share the folder {(double + taken)[0]}",
            "rename one of the garment files, or the variant",
        )


def _settings(settings: CellSettings, name: str, variant: Variant, document: Document | None) -> CellSettings:
    if variant.python is not None or not variant.cell:
        return settings  # another version may have other keys, so it checks them itself
    lines = document.lines if document else {}
    at = ("variants", name, "cell")
    own = {key[3:]: line for key, line in lines.items() if key[:3] == at}
    return overlaid(settings, variant.cell, document.path if document else Path("campaign"), own)


def distinct_garments(garments: Sequence[str], folder: Path = Path()) -> list[str]:
    """Return the garments without repetitions, because a second run with the same garment and seed is no further
    evidence. ALL alone stands for all shipped garments. folder: relative file names start from it."""
    if tuple(garments) == (ALL,):
        return list(list_garments())
    stripped = [g.strip() for g in garments]
    names = [str((folder / g).resolve()) if g.endswith((".yaml", ".yml")) else g for g in stripped]
    return list(dict.fromkeys(names))


def _interpreter(python: str, folder: Path) -> str:
    path = Path(python).expanduser()
    path = path if path.is_absolute() else folder.absolute() / path
    if not path.is_file():
        raise ConfigurationError(
            f"{path}: there is no such Python", "name the bin/python of a virtual environment with foldcell"
        )
    return str(path)  # links are not resolved, because Python finds its virtual environment by the link's location
