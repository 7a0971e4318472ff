"""The job of `screwpose simulate`: a case of a benchmark set, or a scene of one's own."""

from pathlib import Path
from typing import Any

from screwpose.errors import InputError


def _word(dial: str) -> str:
    """The option as it is typed."""
    return f"--{dial.replace('_', '-')}"


def make_case_of_set(out: Path, name: str, seed: int, index: int, dials: dict[str, Any]) -> Path:
    """One case of a benchmark set; returns the path of its case.json.

    Raises
    ------
    InputError
        There is no such set or case, its data is not there, or a dial was turned that the set decides.
    """
    from screwpose.benchmark.sets import get_set

    cases = get_set(name)
    turned = [_word(dial) for dial, value in dials.items() if value is not None]
    if turned:
        raise InputError(
            f"the set {name!r} decides what its cases are",
            field=turned[0],
            remedy="Leave this option away, or --set.",
        )
    cases.check_index(index)
    return cases.make(seed, index, out)


def make_scene(out: Path, seed: int, dials: dict[str, Any]) -> Path:
    """A scene of one's own; returns the path of its case.json.

    Parameters
    ----------
    dials : options of the command by name, None where they were not given.

    Raises
    ------
    InputError
        An option that contradicts another.
    ScrewposeError
        No such scene was found.
    """
    from screwpose.simulation.imperfections import Imperfections
    from screwpose.simulation.scenes import simulate_scene
    from screwpose.simulation.writing import write_case

    turned = {name: value for name, value in dials.items() if value is not None}
    errors = {_DIALS[name]: value for name, value in turned.items() if name in _DIALS}
    try:
        scene = simulate_scene(_scene_options(turned), Imperfections(**errors), seed)
    except InputError as error:
        dial = next((name for name, field in {**_DIALS, **_RANGES}.items() if field == error.field), None)
        if dial is None:
            raise
        raise InputError(error.problem, field=_word(dial), expected=error.expected, remedy=error.remedy) from error
    return write_case(scene, out)


_DIALS = {
    "landmark_noise": "landmark_noise_px",
    "tip_bias": "tip_bias_mm",
    "center_bias": "center_bias_mm",
    "focal_error": "focal_error_percent",
    "principal_error": "principal_error_px",
    "rotation_error": "rotation_error_deg",
    "translation_error": "translation_error_mm",
    "pincushion": "pincushion",
    "s_distortion": "s_distortion_deg",
    "cad_length_error": "cad_length_mm",
    "cad_diameter_error": "cad_diameter_mm",
    "motion": "motion_mm",
    "motion_turn": "motion_deg",
}
_RANGES = {
    "angle": "angle_deg",
    "overlap": "overlap_lat",
    "tilt": "tower_tilt_deg",
    "clutter": "clutter",
    "missing": "missing",
}


def _scene_options(turned: dict[str, Any]) -> Any:
    from screwpose.simulation.scenes_options import MAX_LEVELS, SceneOptions

    screws = turned.get("screws", 2)
    given: dict[str, Any] = {"needles": turned.get("needles", False)}
    if screws != 2:
        given |= {
            "screws": (screws, screws),
            "levels": (-(-screws // 2), min(screws, MAX_LEVELS)),
            "designs": (1, min(screws, 3)),
            "overlap_lat": (0.0, 1.0),
        }
    for name, option in (("angle", "angle_deg"), ("clutter", "clutter"), ("missing", "missing")):
        if name in turned:
            given[option] = (turned[name], turned[name])
    if "missing" in turned:
        given["shift_mm"] = (0.0, 60.0)
        given.setdefault("overlap_lat", (0.0, 1.0))
    if "overlap" in turned:
        given["overlap_lat"] = tuple(turned["overlap"])
    if "tilt" in turned:
        given |= {"polyaxial": 1.0, "tower_tilt_deg": (turned["tilt"], turned["tilt"])}
    if "size" in turned:
        given["image_size"] = (turned["size"], turned["size"])
    return SceneOptions(**given)
