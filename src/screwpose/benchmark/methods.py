"""The methods that are compared, by name: each is a function from a case to its result."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module

from screwpose.errors import InputError
from screwpose.files.case import Case
from screwpose.files.result import Result
from screwpose.files.wording import nearest
from screwpose.registration import Progress
from screwpose.solve import SolveOptions, solve

MethodFunction = Callable[[Case, SolveOptions, Progress | None], Result]
"""``method(case, options, progress) -> Result``.

`options` are the run's, with the case's own seed in ``options.search.seed``: a method that is random draws from that
alone. `progress` may be called now and then with a fraction and a few words; None where nobody listens. An error of
`screwpose.errors` counts the case as failed.
"""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,60}")


@dataclass(frozen=True)
class Method:
    """A registered method.

    Parameters
    ----------
    name : stands in records, tables and the names of folders.
    description : one line.
    solve : the method itself.
    """

    name: str
    description: str
    solve: MethodFunction


METHODS: dict[str, Method] = {}


def register_method(name: str, description: str) -> Callable[[MethodFunction], MethodFunction]:
    """Register the function that follows as a method.

    Processes of a cluster have to know the method too: let it stand in a module that they can import, and name it
    ``module:function``.

    Raises
    ------
    InputError
        The name is taken by another function, or is no name for a folder.
    """
    if not _NAME.fullmatch(name):
        raise InputError(
            f"{name!r} cannot be the name of a method",
            expected="letters, digits, `_`, `.` and `-`, beginning with a letter or digit",
            remedy="It becomes the name of a folder.",
        )

    def register(function: MethodFunction) -> MethodFunction:
        known = METHODS.get(name)
        if known is not None and _place(known.solve) != _place(function):
            raise InputError(f"there is a method {name!r} already", remedy="Give it another name.")
        METHODS[name] = Method(name, description, function)
        return function

    return register


def get_method(name: str) -> Method:
    """A method by its registered name, or one's own by ``module:function``.

    A function that is not registered goes by its own name, and by the first line of its docstring.

    Raises
    ------
    InputError
        There is none; the message has the nearest name.
    """
    if ":" in name:
        return _imported(name)
    if name not in METHODS:
        near = nearest(name, METHODS)
        raise InputError(
            f"there is no method {name!r}",
            field="--method",
            expected=f"one of {', '.join(sorted(METHODS))}, or module:function for one of your own",
            remedy=f"Did you mean {near}?" if near else None,
        )
    return METHODS[name]


def _imported(name: str) -> Method:
    module_name, _, function_name = name.partition(":")
    try:
        function = getattr(import_module(module_name), function_name)
    except (ImportError, AttributeError, ValueError) as error:  # ValueError: an empty module name
        raise InputError(
            f"the method {name!r} cannot be imported ({error})",
            field="--method",
            expected="module:function",
            remedy="The module has to be installed, or its folder in PYTHONPATH, here and on every worker.",
        ) from error
    for method in METHODS.values():
        if method.solve is function:
            return method
    if not callable(function):
        raise InputError(f"{name!r} is no function", field="--method", expected="module:function")
    first_line = (function.__doc__ or "").strip().partition("\n")[0]
    register_method(function_name, first_line or name)(function)
    return METHODS[function_name]


def _place(function: MethodFunction) -> tuple[str, str]:
    return function.__module__, getattr(function, "__qualname__", repr(function))


@register_method("paper", "arXiv 2511.05702 as it is: the combination with the higher Dice score after registration")
def _paper(case: Case, options: SolveOptions, progress: Progress | None) -> Result:
    return solve(case, replace(options, method="paper"), progress)


@register_method("epipolar", "pairing by epipolar distance alone, as Esfandiari 2018: a baseline without models")
def _epipolar(case: Case, options: SolveOptions, progress: Progress | None) -> Result:
    return solve(case, replace(options, method="epipolar"), progress)


@register_method("default", "this program's own: pairing by the marks and the CAD, registration by thickness")
def _default(case: Case, options: SolveOptions, progress: Progress | None) -> Result:
    return solve(case, replace(options, method="default"), progress)
