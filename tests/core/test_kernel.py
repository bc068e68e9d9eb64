"""Sharing out work among threads."""

import threading
import time

import pytest

from eiwa.core.kernel import on_all_threads


@pytest.fixture(params=["1", "2", "5"])
def threads(request, monkeypatch):
    monkeypatch.setenv("EIWA_THREADS", request.param)
    return int(request.param)


def test_results_stand_in_the_order_of_the_items(threads):
    def slow_first(number, word):
        time.sleep(0.01 if number == 0 else 0)
        return number, word

    assert on_all_threads(slow_first, range(7), "abcdefg") == list(enumerate("abcdefg"))


def test_no_items_give_no_results(threads):
    assert on_all_threads(abs, []) == []


def test_an_error_reaches_the_caller(threads):
    def fail_at_three(number):
        if number == 3:
            raise ValueError("three")

    with pytest.raises(ValueError, match="three"):
        on_all_threads(fail_at_three, range(6))


def test_an_error_does_not_leave_work_behind(threads):
    running = []

    def work(number):
        running.append(number)
        time.sleep(0.01)
        running.remove(number)
        if number == 0:
            raise ValueError

    with pytest.raises(ValueError):
        on_all_threads(work, range(8))
    assert running == []


def test_the_caller_takes_part(threads):
    caller, came = threading.current_thread(), threading.Event()

    def work(_):
        if threading.current_thread() is caller:
            came.set()
        return came.wait(60)

    assert all(on_all_threads(work, range(20)))


def test_work_may_share_out_work(threads):
    inner = on_all_threads(lambda a: sum(on_all_threads(lambda b: a * b, range(4))), range(5))
    assert inner == [6 * a for a in range(5)]
