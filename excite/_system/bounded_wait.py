"""Bound the time of functions of other packages that may wait for ever."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

Value = TypeVar("Value")


def value_within(
    seconds: float, function: Callable[[], Value], errors: tuple[type[Exception], ...] = ()
) -> Value:
    """Return the value of a function that runs in a thread, which ends with the process.

    Args:
        seconds: Longest time [s].
        function: The function.
        errors: Types of errors that it raises.

    Raises:
        TimeoutError: It has not returned in time.
    """
    value: Future[Value] = Future()

    def run() -> None:
        try:
            value.set_result(function())
        except errors as error:
            value.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return value.result(seconds)
