"""What can be asked for, and each thing that cannot, by the text of its error."""

from dataclasses import fields
from pathlib import Path

import pytest

from screwpose.benchmark import METHODS, get_method, get_set, make_request, register_method
from screwpose.benchmark.folder_set import find_cases, own_set
from screwpose.benchmark.request import AskedOptions, read_request, same_again
from screwpose.errors import InputError
from screwpose.files.atomic import write_json
from screwpose.pairing.segment import LandmarkNoise
from screwpose.registration import SearchOptions
from screwpose.solve import SolveOptions
from tests.benchmark.bench_cases import write_own_cases
from tests.benchmark.bench_methods import PLACE, near

OPTIONS = SolveOptions(
    faces=None,
    noise=LandmarkNoise(sigma_px=0.5, length_sigma_mm=0.25),
    combinations=3,
    registered=1,
    engine="bitrows",
    refinement="evolution",
    cameras="off",
    search=SearchOptions(
        max_shift_mm=1.5, max_tilt_deg=4.5, max_roll_deg=90.0, generations=7, population=2, tolerance=0.02, seed=11
    ),
)


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_own_cases(tmp_path_factory.mktemp("request") / "my phantoms", 3)


# ---- requests


def test_every_option_of_the_solver_goes_through_run_json(tmp_path: Path) -> None:
    request = make_request(sets=["paper"], methods=["paper"], options=OPTIONS)
    read = read_request(write_json(tmp_path / "run.json", request))
    assert read == request
    assert read.options.solve_options(11) == OPTIONS
    assert AskedOptions().solve_options(0) == SolveOptions()


def test_no_option_of_the_solver_is_forgotten() -> None:
    asked = {
        name: getattr(owner, name)
        for owner in (OPTIONS, OPTIONS.noise, OPTIONS.search)
        for name in (field.name for field in fields(owner))
    }
    defaults = SolveOptions()
    del asked["held"]  # a person's pairing is of one case, and nothing that a run can be asked for
    for name in asked:  # OPTIONS differ from the defaults in all that a run can be asked for
        for owner in (defaults, defaults.noise, defaults.search):
            assert name == "method" or not hasattr(owner, name) or getattr(owner, name) != asked[name], name
    assert set(asked) - {"method", "noise", "search", "seed"} == set(AskedOptions.model_fields)


def test_counts_stop_at_the_sets_sizes(own: Path) -> None:
    request = make_request(sets=["pairs", "real", "paper"], methods=["paper"], count=20)
    assert [(one.name, one.count) for one in request.sets] == [("pairs", 20), ("real", 16), ("paper", 5)]
    assert request.cases == 41
    assert [one.count for one in make_request(sets=["pairs"], methods=["paper"]).sets] == [10]
    assert [one.count for one in make_request(cases=own, methods=["paper"]).sets] == [3]
    first = make_request(cases=own, methods=["paper"], count=2)
    assert first.own_cases is not None
    assert first.own_cases.names == ("case-0", "case-1")


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"sets": ["pears"]}, r"--set: there is no benchmark set 'pears'; expected one of .*\. Did you mean pairs\?"),
        ({"methods": ["papr"]}, r"--method: there is no method 'papr'; expected one of .*\. Did you mean paper\?"),
        # Other tests may have registered methods of their own before this one.
        ({"methods": ["zzz"]}, r"no method 'zzz'; expected one of .*default, epipolar, .*paper, or module:function"),
        ({"sets": []}, r"neither --set nor --cases is given"),
        ({"cases": "."}, r"both --set and --cases are given; .* Run your own cases into a folder of their own"),
        ({"count": 0}, r"--count: 0 cases are none; expected 1 or more"),
        ({"methods": ["paper", "paper"]}, r"--method: 'paper' is named 2 times; expected each name once"),
        ({"sets": ["pairs", "pairs"]}, r"--set: 'pairs' is named 2 times"),
        ({"sets": ["pairs", ""]}, r"--set: a name is missing"),
        ({"methods": [f"{PLACE}:none"]}, r"bench_methods:none' cannot be imported \(.*'none'.*PYTHONPATH"),
        ({"methods": ["no_such_module:f"]}, r"'no_such_module:f' cannot be imported \(No module named"),
        ({"methods": [":f"]}, r"':f' cannot be imported"),
        ({"methods": [f"{PLACE}:not_a_function"]}, r"not_a_function' is no function; expected module:function"),
        ({"methods": [f"{PLACE}:near", "near"]}, r"'near' is named 2 times"),
    ],
    ids=str,
)
def test_what_cannot_be_asked_for(asked: dict, said: str) -> None:
    with pytest.raises(InputError, match=said):
        make_request(**{"sets": ["paper"], "methods": ["paper"], **asked})


def test_the_first_difference_is_told() -> None:
    stored = make_request(sets=["paper"], methods=["paper"], options=OPTIONS)
    later = stored.model_copy(update={"started": "another day"})
    assert stored.difference(later) is None
    other = make_request(sets=["paper", "pairs"], methods=["paper"])
    assert stored.difference(other) == "--set: paper in the folder, paper, pairs now"
    fewer = make_request(sets=["paper"], methods=["paper"], count=2, options=OPTIONS)
    assert stored.difference(fewer) == "--count: paper 5 in the folder, paper 2 now"
    defaults = make_request(sets=["paper"], methods=["paper"])
    assert stored.difference(defaults) == "--faces: 0 in the folder, 1000 now"
    software = stored.software.model_copy(update={"version": "9.9"})
    assert "screwpose 9.9 now" in str(stored.difference(stored.model_copy(update={"software": software})))
    grown = (stored.sets[0].model_copy(update={"version": "99"}),)
    assert "the sets' versions: paper" in str(stored.difference(stored.model_copy(update={"sets": grown})))


def test_a_request_can_be_made_again_but_for_what_is_said(own: Path) -> None:
    for stored in (
        make_request(sets=["pairs", "paper"], methods=["paper", f"{PLACE}:near"], count=7, seed=5, options=OPTIONS),
        make_request(cases=own, methods=["epipolar"], seed=5),
    ):
        assert stored.difference(same_again(stored)) is None
        assert stored.difference(same_again(stored, seed=6)) == "--seed: 5 in the folder, 6 now"
    other = same_again(stored, sets=["clean"])
    assert other.own_cases is None
    assert [one.name for one in other.sets] == ["clean"]


# ---- a user's own cases


def test_own_cases_are_found_by_name(own: Path, tmp_path: Path) -> None:
    (own / "notes").mkdir(exist_ok=True)
    (own / "readme.txt").write_text("")
    cases = find_cases(own)
    assert cases.names == ("case-0", "case-1", "case-2")
    made = own_set(cases)
    assert (made.name, made.size) == ("own-my-phantoms", 3)
    assert made.make(0, 1, tmp_path / "new").read_bytes() == (own / "case-1/case.json").read_bytes()
    assert not (tmp_path / "new").exists()
    alone = find_cases(own / "case-2")  # the folder of a single case
    assert own_set(alone).make(0, 0, tmp_path).samefile(own / "case-2/case.json")


def test_a_folder_without_cases_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--cases: there is no case in this folder; .*case\.json and a truth\.json"):
        find_cases(tmp_path)
    with pytest.raises(InputError, match=r"nothing: --cases: the folder cannot be read \(No such file"):
        find_cases(tmp_path / "nothing")


# ---- methods


def test_the_methods_of_the_house() -> None:
    assert {"paper", "epipolar", "default"} <= set(METHODS)
    assert all(method.description and "\n" not in method.description for method in METHODS.values())


def test_the_named_methods_are_the_solvers(monkeypatch: pytest.MonkeyPatch) -> None:
    from screwpose.benchmark import methods

    seen: list[str] = []
    monkeypatch.setattr(methods, "solve", lambda _case, options, _progress: seen.append(options.method))
    for name in ("paper", "epipolar", "default"):
        get_method(name).solve(None, OPTIONS, None)  # type: ignore[arg-type]
    assert seen == ["paper", "epipolar", "default"]


def test_a_method_of_ones_own_goes_by_its_name() -> None:
    method = get_method(f"{PLACE}:near")
    assert (method.name, method.solve) == ("near", near)
    assert method.description == "The truth of the case that is worked by hand, moved a little by the search's seed."
    assert get_method(f"{PLACE}:near") is method


def test_a_method_is_registered_under_a_name_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "near", METHODS["paper"])
    with pytest.raises(InputError, match=r"there is a method 'paper' already. Give it another name"):
        register_method("paper", "not the paper's")(near)
    for name in ("", "a/b", "..", "a b"):
        with pytest.raises(InputError, match=r"cannot be the name of a method; .* It becomes the name of a folder"):
            register_method(name, "no folder")
    monkeypatch.delitem(METHODS, "near")
    register_method("mine", "one line")(near)
    assert get_method("mine").description == "one line"
    assert get_method(f"{PLACE}:near").name == "mine"
    monkeypatch.delitem(METHODS, "mine")


def test_an_unknown_set_names_the_nearest() -> None:
    with pytest.raises(InputError, match=r"'cluter'; .*Did you mean clutter\?"):
        get_set("cluter")
