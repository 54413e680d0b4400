"""Signals that end a command: Ctrl-C, SIGTERM and SIGHUP."""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

NAMES = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "terminated"}
"""Signals that end a command, and the word for it."""
PR_SET_PDEATHSIG = 1  # <sys/prctl.h>


class Interruption(KeyboardInterrupt):
    """A signal that ends a command; its text is the word for it."""


@contextlib.contextmanager
def handled(end: Callable[[str], None] | None) -> Iterator[None]:
    """Handle the signals within the block, unless they are ignored already (`nohup`, background
    jobs).

    Forked worker processes do not see signals to the group of the process (Ctrl-C of a terminal,
    `timeout`) and end with it.

    Args:
        end: Called with the word for the signal; it should end the process. It is called where an
            exception would be lost or printed: Python drops what is raised in callbacks of the
            garbage collector, and extension modules turn an interrupted import into another error.
            None: `Interruption` is raised, and the handlers of before are restored after the block.
    """
    if threading.current_thread() is not threading.main_thread():  # which alone may handle signals
        yield
        return
    if sys.platform == "linux":
        import ctypes

        _state.prctl = ctypes.CDLL(None).prctl
    before = {
        kind: old
        for kind in _kinds()
        if (old := signal.getsignal(kind)) not in (None, signal.SIG_IGN)
    }
    _state.end = end
    if (
        end is not None
        # the first that is registered is called last: after it, Python would restore the system's
        # handlers
    ):
        atexit.register(_replace_handlers, signal.SIG_IGN)
    for kind in before:
        signal.signal(kind, _handle)
    _state.parent = os.getpid()
    try:
        yield
    finally:
        _state.parent = None
        for kind, old in before.items() if end is None else ():
            signal.signal(kind, old)


@contextlib.contextmanager
def raised() -> Iterator[None]:
    """Raise the signals as `Interruption` within the block, for commands that run until they are
    interrupted."""
    end, _state.end = _state.end, None
    try:
        yield
    finally:
        _state.end = end


def exit_with(code: int) -> None:
    """Let signals end the process with an exit code from now on: the command is done, and only the
    interpreter has to end."""
    if threading.current_thread() is threading.main_thread():
        _replace_handlers(lambda number, frame: os._exit(code))


class _State:
    """How signals are handled, and what forked worker processes need to know.

    Attributes:
        end: As in `handled`.
        parent: The process of the command, while it runs.
        prctl: The function of Linux's C library.
    """

    end: Callable[[str], None] | None = None
    parent: int | None = None
    prctl: Any = None


_state = _State()


def _handle(number: int, frame: FrameType | None) -> None:
    word = NAMES[signal.Signals(number).name]
    if _state.end is not None:
        _state.end(word)
    raise Interruption(word)


def _kinds() -> set[signal.Signals]:
    return {getattr(signal, name) for name in NAMES if hasattr(signal, name)}


def _replace_handlers(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    for kind in _kinds():
        if signal.getsignal(kind) != signal.SIG_IGN:
            signal.signal(kind, handler)


def _block() -> None:
    """Before a fork: a signal that reaches the child before it has handlers of its own would be
    lost, and a pool wait for ever."""
    if _state.parent is not None:
        signal.pthread_sigmask(signal.SIG_BLOCK, _kinds())


def _unblock() -> None:
    if _state.parent is not None:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _kinds())


def _become_worker() -> None:
    """In a forked child: leave the process group, and end with the parent."""
    if _state.parent is None:
        return
    _replace_handlers(signal.SIG_DFL)
    os.setpgid(
        0,
        0,
        # signals to the group are for the parent: a worker that dies of one may take a lock of the
        # pool
        # with it
    )
    if (
        _state.prctl is not None
    ):  # without that, workers of a pool wait for ever for a process that was killed
        _state.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != _state.parent:
            os._exit(1)
    _state.parent = os.getpid()
    _unblock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_block, after_in_parent=_unblock, after_in_child=_become_worker)
