"""What the command line and the workbench both do with a case on disk."""

from pathlib import Path

from screwpose._compiling import NOTE, must_compile
from screwpose.files.case import Case, inspect_case
from screwpose.files.findings import Finding, errors_in
from screwpose.registration import Progress


def check_files(case_path: str | Path, landmark_sigma_px: float) -> tuple[Finding, ...]:
    """Everything that can be known to be wrong with a case: its files, then whether they agree with each other."""
    return checked_case(case_path, landmark_sigma_px)[1]


def checked_case(case_path: str | Path, landmark_sigma_px: float) -> tuple[Case | None, tuple[Finding, ...]]:
    """A case, None where it cannot be solved, and everything that can be known to be wrong with it."""
    from screwpose.pairing.cameras import with_sigmas
    from screwpose.pairing.plausibility import check_plausibility
    from screwpose.pairing.segment import LandmarkNoise

    case, findings = inspect_case(case_path)
    if case is None or errors_in(findings):
        return None, findings
    noise = LandmarkNoise(sigma_px=landmark_sigma_px)
    return case, findings + check_plausibility(with_sigmas(case, "given", noise), noise)


def saying_that_it_compiles(progress: Progress) -> Progress:
    """The same progress, each word followed by why it takes so long where it is the first time."""
    if not must_compile():
        return progress
    return lambda fraction, what: progress(fraction, f"{what} ({NOTE})")
