"""Threads give what a loop gives."""

import re
import threading

import pytest

from screwpose._threads import available_threads, in_threads
from screwpose.errors import InputError


def test_order_errors_and_no_threads_within_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SCREWPOSE_THREADS", "3")
    assert available_threads() == 3
    assert in_threads(lambda n: n * n, range(20)) == [n * n for n in range(20)]
    barrier = threading.Barrier(3, timeout=10)

    def meet(n: int) -> tuple[int, set[int]]:
        barrier.wait()  # passed only if three run at once
        inner = in_threads(lambda _: threading.get_ident(), range(4))
        return n, set(inner) - {threading.get_ident()}

    assert in_threads(meet, range(3)) == [(n, set()) for n in range(3)]
    given_up = threading.Event()

    def fail_or_wait(n: int) -> int:
        if n == 0:
            return 1 // n
        assert given_up.wait(timeout=10)  # the error of another is told before this one is waited for
        return n

    with pytest.raises(ZeroDivisionError):
        in_threads(fail_or_wait, [0, 1, 2], given_up.set)


def test_one_thread_is_a_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SCREWPOSE_THREADS", "1")
    assert set(in_threads(lambda _: threading.get_ident(), range(5))) == {threading.get_ident()}
    monkeypatch.setenv("SCREWPOSE_THREADS", "")
    assert available_threads() >= 1


@pytest.mark.parametrize("wanted", ["many", "0", "-2", "2.5", "\N{SUPERSCRIPT TWO}"])
def test_a_number_of_threads_that_is_none_is_an_error(wanted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SCREWPOSE_THREADS", wanted)
    says = f"SCREWPOSE_THREADS: the environment variable is {wanted!r}; expected a positive integer.*unset it"
    with pytest.raises(InputError, match=re.escape(says).replace(r"\.\*", ".*")):
        available_threads()
    with pytest.raises(InputError, match="SCREWPOSE_THREADS"):
        in_threads(abs, [1, 2])
