"""What a benchmark run was asked for: run.json, the first file of its folder."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from screwpose import __version__
from screwpose.benchmark.folder_set import OwnCases, find_cases, own_set
from screwpose.benchmark.methods import get_method
from screwpose.benchmark.sets import BenchmarkSet, get_set
from screwpose.errors import InputError
from screwpose.files.schema import Software
from screwpose.files.values import Count, FileModel, Name, NotNegative
from screwpose.files.wording import read_model
from screwpose.pairing.cameras import CameraMode
from screwpose.pairing.segment import LandmarkNoise
from screwpose.registration import SearchOptions
from screwpose.solve import Engine, Refinement, SolveOptions

RUN_FORMAT = "screwpose-run/1"
RUN_FILE = "run.json"
USUAL_COUNT = 10


class AskedOptions(FileModel):
    """The options of every method: `SolveOptions` without the method and the seed, which differ by method and case."""

    faces: Count = 1000  # 0: the CAD as it is
    combinations: Count = 6
    registered: Count = 2
    sigma_px: NotNegative = 2.0
    length_sigma_mm: NotNegative = 1.0
    max_shift_mm: NotNegative = 2.0
    max_tilt_deg: NotNegative = 5.0
    max_roll_deg: NotNegative = 15.0
    generations: Count = 60
    population: Count = 5
    tolerance: NotNegative = 1e-3
    engine: Engine | None = None
    refinement: Refinement | None = None
    cameras: CameraMode = "given"

    @classmethod
    def of(cls, options: SolveOptions) -> "AskedOptions":
        """What of the solver's options is asked of every method and case."""
        values = {**vars(options), **vars(options.noise), **vars(options.search), "faces": options.faces or 0}
        return cls(**{name: values[name] for name in cls.model_fields})

    def solve_options(self, search_seed: int) -> SolveOptions:
        """The solver's options for one case; the method is each method's own business."""
        return SolveOptions(
            noise=LandmarkNoise(sigma_px=self.sigma_px, length_sigma_mm=self.length_sigma_mm),
            faces=self.faces or None,
            combinations=self.combinations,
            registered=self.registered,
            engine=self.engine,
            refinement=self.refinement,
            cameras=self.cameras,
            search=SearchOptions(
                max_shift_mm=self.max_shift_mm,
                max_tilt_deg=self.max_tilt_deg,
                max_roll_deg=self.max_roll_deg,
                generations=self.generations,
                population=self.population,
                tolerance=self.tolerance,
                seed=search_seed,
            ),
        )


class AskedSet(FileModel):
    """A set of cases, and how many of them: the first `count`."""

    name: Name
    version: Name
    count: Count


class AskedMethod(FileModel):
    """A method by the name it goes by, and ``module:function`` where it is the user's own."""

    name: Name
    source: Name | None = None


class BenchRequest(FileModel):
    """run.json: all that decides what the records of a run are. Two runs of one request have the same records."""

    format: Literal["screwpose-run/1"]
    software: Software
    started: str
    seed: Count
    sets: tuple[AskedSet, ...]
    own_cases: OwnCases | None = None
    methods: tuple[AskedMethod, ...]
    options: AskedOptions

    @property
    def cases(self) -> int:
        """How many cases there are in all."""
        return sum(one.count for one in self.sets)

    def difference(self, other: "BenchRequest") -> str | None:
        """The first thing in which another request differs, in words; None where both ask for the same."""
        mine, others = self._told(), other._told()
        for what, value in mine.items():
            if others[what] != value:
                return f"{what}: {value} in the folder, {others[what]} now"
        return None

    def _told(self) -> dict[str, str]:
        told = {
            "--set": ", ".join(one.name for one in self.sets),
            "--cases": "none" if self.own_cases is None else self.own_cases.folder,
            "--method": ", ".join(one.source or one.name for one in self.methods),
            "--seed": str(self.seed),
            "--count": ", ".join(f"{one.name} {one.count}" for one in self.sets),
            "the sets' versions": ", ".join(f"{one.name} {one.version}" for one in self.sets),
            "the case folders": "none" if self.own_cases is None else ", ".join(self.own_cases.names),
            "the program": f"{self.software.name} {self.software.version}",
        }
        options = self.options.model_dump()
        return told | {
            _OPTION_NAMES.get(name, name): f"{value:g}" if isinstance(value, int | float) else str(value)
            for name, value in options.items()
        }


_OPTION_NAMES = {
    "faces": "--faces",
    "sigma_px": "--landmark-sigma",
    "max_shift_mm": "--max-shift",
    "max_tilt_deg": "--max-tilt",
    "max_roll_deg": "--max-roll",
    "generations": "--generations",
    "population": "--population",
}


def make_request(
    *,
    sets: Sequence[str] = (),
    cases: str | Path | None = None,
    methods: Sequence[str],
    count: int | None = None,
    seed: int = 1,
    options: SolveOptions | None = None,
) -> BenchRequest:
    """Put a request together from names.

    Parameters
    ----------
    sets, cases : the names of sets, or a folder of one's own case folders: one of the two.
    methods : names, or ``module:function``.
    count : how many cases of each set, at most; None: 10 of each set, all of one's own.
    options : of every method; its method and the seed of its search are not looked at.

    Raises
    ------
    InputError
        A name is not known or stands there twice, or there is nothing to do.
    """
    if bool(sets) == (cases is not None):
        raise InputError(
            "both --set and --cases are given" if sets else "neither --set nor --cases is given",
            expected="the names of sets, or a folder of your own cases",
            remedy="Run your own cases into a folder of their own." if sets else None,
        )
    if count is not None and count < 1:
        raise InputError(f"{count} cases are none", field="--count", expected="1 or more")
    own = None if cases is None else find_cases(cases, count)
    asked = [own_set(own)] if own else [get_set(name) for name in _once(sets, "--set")]
    return BenchRequest(
        format=RUN_FORMAT,
        software=Software(name="screwpose", version=__version__),
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        seed=seed,
        sets=tuple(_asked(one, USUAL_COUNT if count is None and own is None else count) for one in asked),
        own_cases=own,
        methods=_asked_methods(methods),
        options=AskedOptions.of(options or SolveOptions()),
    )


def _asked(one: BenchmarkSet, count: int | None) -> AskedSet:
    sizes = [number for number in (one.size, count) if number is not None]
    return AskedSet(name=one.name, version=str(one.version), count=min(sizes))


def _asked_methods(names: Sequence[str]) -> tuple[AskedMethod, ...]:
    asked = [AskedMethod(name=get_method(name).name, source=name if ":" in name else None) for name in names]
    _once([one.name for one in asked], "--method")
    return tuple(asked)


def _once(names: Sequence[str], option: str) -> Sequence[str]:
    if not names or not all(names):
        raise InputError("a name is missing", field=option, expected="one name, or several with commas between them")
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{name!r} is named {names.count(name)} times", field=option, expected="each name once")
    return names


def sets_of(request: BenchRequest) -> dict[str, BenchmarkSet]:
    """The sets that a request names, by name."""
    if request.own_cases is not None:
        own = own_set(request.own_cases)
        return {own.name: own}
    return {one.name: get_set(one.name) for one in request.sets}


def same_again(stored: BenchRequest, **given: Any) -> BenchRequest:
    """The request that a folder's run would be here and now, with what is `given` in the place of what stands there.

    Parameters
    ----------
    given : as for `make_request`.
    """
    own = stored.own_cases
    again: dict[str, Any] = {
        "sets": () if own else tuple(one.name for one in stored.sets),
        "cases": own.folder if own else None,
        "methods": tuple(one.source or one.name for one in stored.methods),
        "count": max(one.count for one in stored.sets),
        "seed": stored.seed,
        "options": stored.options.solve_options(0),
    }
    if "sets" in given or "cases" in given:
        again |= {"sets": (), "cases": None}
    return make_request(**again | given)


def read_request(path: Path) -> BenchRequest:
    """Read and check a run.json.

    Raises
    ------
    CaseError
        It is missing or breaks the format.
    """
    return read_model(path, BenchRequest, RUN_FORMAT)
