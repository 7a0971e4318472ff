"""measures.json: what summary.json says, with the interval of every figure and the strata beside it."""

from typing import Literal

from pydantic import Field

from screwpose.files.schema import Software
from screwpose.files.values import Count, FileModel, Fraction, Name, NotNegative, Number

MEASURES_FORMAT = "screwpose-measures/1"


class Estimate(FileModel):
    """A figure with its 95 % bootstrap interval over cases."""

    value: Number
    low: Number
    high: Number


class Rate(FileModel):
    """A share with its 95 % Wilson interval."""

    hits: Count
    of: Count
    value: Fraction
    low: Fraction
    high: Fraction


class Distribution(FileModel):
    """A measure over screws, cases or pairs of screws. The largest value has no interval: resampling knows none."""

    count: Count
    median: Estimate
    p90: Estimate
    p95: Estimate
    p99: Estimate
    max: Number


class Bin(FileModel):
    """One bin of the calibration: cases whose probability lies in it, and how many of them are right."""

    low: Fraction
    high: Fraction
    cases: Count
    mean_probability: Fraction
    right: Rate


class Calibration(FileModel):
    """Whether a probability of 0.9 is right nine times in ten.

    `cases` counts what was told a probability: cases, or pairs and marks alone.
    """

    cases: Count
    error: NotNegative
    brier: NotNegative | None = Field(None, description="mean of the squares of the probability less 1 or 0")
    bins: tuple[Bin, ...]


class Stratum(FileModel):
    """The cases of one bin of a stratum; `low` and `high` are its bounds, absent where it has none."""

    name: Name
    low: Number | None = None
    high: Number | None = None
    cases: Count
    right: Rate
    confident_wrong: Rate
    refused: Rate
    success: Rate
    tip_mm: Distribution | None = None


class Offset(FileModel):
    """The screws whose registration began with the tip off by `low` to `high` mm."""

    name: Name
    low: Number
    high: Number | None = None
    screws: Count
    success: Rate
    tip_mm: Distribution | None = None


class MethodMeasures(FileModel):
    """One method on one set. Every key is defined in docs/measures.md."""

    cases: Count
    screws: Count
    failed: Count = Field(description="cases that could not be computed; they are among the refused")
    rates: dict[Name, Rate]
    errors: dict[Name, Distribution] = Field(description="over the screws whose pairing is right")
    start: dict[Name, Distribution] = Field(description="the same errors of the poses that the registration began with")
    relations: dict[Name, Distribution] = Field(description="over every two screws of a case that are paired right")
    parts: dict[Name, Distribution] = Field(description="over the screws whose parts' true poses are known")
    bias: dict[Name, Estimate] = Field(description="signed means: what is left of errors that should cancel")
    stages: dict[Name, Distribution] = Field(description="Dice and loss of the true combinations")
    coverage: dict[Name, Rate]
    calibration: Calibration | None = None
    told: Calibration | None = Field(None, description="the same of single pairs, and of marks without a partner")
    seconds: Distribution | None = None
    steps: dict[Name, Distribution] = Field(description="seconds in each step")
    strata: dict[Name, tuple[Stratum, ...]]
    offsets: tuple[Offset, ...] = Field(description="screws by how far off the start of their registration was")


class SetMeasures(FileModel):
    """One set of cases."""

    version: Name
    methods: dict[Name, MethodMeasures]


class MeasuresFile(FileModel):
    """measures.json."""

    format: Literal["screwpose-measures/1"] = "screwpose-measures/1"
    sets: dict[Name, SetMeasures]
    calibration: dict[Name, Calibration] = Field(default={}, description="of each method, over all sets")
    told: dict[Name, Calibration] = Field(default={}, description="the same of single pairs and marks")
    seed: Count
    started: str
    machine: str
    software: Software
