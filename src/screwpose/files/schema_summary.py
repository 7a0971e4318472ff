"""summary.json of a benchmark run, key by key."""

from typing import Literal

from pydantic import Field

from screwpose.files.schema_result import Software
from screwpose.files.values import Count, FileModel, Fraction, Name, NotNegative, Number

SUMMARY_FORMAT = "screwpose-summary/1"


class Quantiles(FileModel):
    """The distribution of one measure; every block has the same five keys."""

    median: Number = Field(description="half of the values are below")
    p90: Number = Field(description="90 % of the values are below")
    p95: Number = Field(description="95 % of the values are below")
    p99: Number = Field(description="99 % of the values are below")
    max: Number = Field(description="the largest value")


class PairingRates(FileModel):
    """What came of the pairings, as shares of all cases."""

    right: Fraction | None = Field(None, description="cases whose whole pairing is right")
    confident: Fraction | None = Field(None, description="cases that were answered as confident")
    confident_wrong: Fraction | None = Field(None, description="cases that were answered as confident and are wrong")
    ambiguous: Fraction | None = Field(None, description="cases that were answered as ambiguous")
    refused: Fraction | None = Field(None, description="cases that were refused")
    pairs_right: Fraction | None = Field(None, description="single pairs that are right, as a share of all pairs")


class StageQuantiles(FileModel):
    """The scores of the right combinations at one stage."""

    dice: Quantiles | None = Field(None, description="Dice scores")
    loss: Quantiles | None = Field(None, description="mean losses")


class Coverage(FileModel):
    """Whether the sigmas hold: shares of tips inside their own error ellipsoid, by the covariance."""

    tip_1sigma: Fraction | None = Field(None, description="inside the 68.27 % ellipsoid")
    tip_2sigma: Fraction | None = Field(None, description="inside the 95.45 % ellipsoid")


class MethodSummary(FileModel):
    """One method on one set. Errors are over the screws whose pairing is right; what does not apply is absent."""

    cases: Count = Field(description="all cases, those that were not solved among them")
    screws: Count = Field(description="all screws of all cases")
    pairing: PairingRates | None = Field(None, description="what came of the pairings")
    tip_mm: Quantiles | None = Field(None, description="distance of the tip from the truth, mm")
    center_mm: Quantiles | None = Field(None, description="distance of the centre from the truth, mm")
    head_mm: Quantiles | None = Field(None, description="distance of the head from the truth, mm")
    axis_deg: Quantiles | None = Field(None, description="angle between the axes, degrees")
    roll_deg: Quantiles | None = Field(None, description="difference of the roll, degrees")
    pre: StageQuantiles | None = Field(None, description="scores before registration")
    post: StageQuantiles | None = Field(None, description="scores after registration")
    coverage: Coverage | None = Field(None, description="whether the sigmas hold")
    calibration_error: NotNegative | None = Field(
        None, description="expected difference between a pairing's probability and how often it is right"
    )
    seconds: Quantiles | None = Field(None, description="wall time of a case, s")


class SetSummary(FileModel):
    """One set of cases."""

    methods: dict[Name, MethodSummary] = Field(description="the methods by name: paper, epipolar, default")


class SummaryFile(FileModel):
    """summary.json: how good each method was on each set of cases."""

    format: Literal["screwpose-summary/1"] = Field(description="the format and its version")
    sets: dict[Name, SetSummary] = Field(description="the sets of cases by name")
    ratios: dict[Name, dict[Name, dict[Name, Number]]] | None = Field(
        None, description="for each set and pair of methods, written a/b, the ratios of a's measure to b's"
    )
    seed: Count = Field(description="the seed from which everything random was drawn")
    started: str = Field(description="when the run began, ISO 8601")
    machine: str = Field(description="the machine: processor, cores, system")
    software: Software = Field(description="the program that was measured")
