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
"""Signals that end a command -> the word for it in messages."""
PR_SET_PDEATHSIG = 1
"""Option of `prctl`, of <sys/prctl.h>: the signal that a process gets when its parent ends."""


class Interruption(KeyboardInterrupt):
    """A signal that ends a command; its text is the word of NAMES."""


@contextlib.contextmanager
def handled(end: Callable[[str], None] | None) -> Iterator[None]:
    """Handle the signals within the block, except ignored ones (`nohup`, background jobs).

    Forked worker processes do not receive signals to the process group (Ctrl-C of a terminal,
    `timeout`), and end with their parent.

    Args:
        end: Called with the word for the signal; it should end the process. An exception instead
            could be lost: Python discards exceptions in callbacks of the garbage collector, and
            extension modules convert an interrupted import into another error. None: `Interruption`
            is raised, and the former handlers are restored after the block.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may handle signals
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
    if end is not None:
        # registered first, so called last: afterwards Python would restore the system's handlers
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
    """Raise the signals as `Interruption` within the block.

    For commands that run until they are interrupted.
    """
    end, _state.end = _state.end, None
    try:
        yield
    finally:
        _state.end = end


def exit_with(code: int) -> None:
    """Let signals end the process with an exit code from now on.

    The command has ended, and only the interpreter has to end.
    """
    if threading.current_thread() is threading.main_thread():
        _replace_handlers(lambda number, frame: os._exit(code))


class _State:
    """Handling of signals, and the data that forked worker processes need.

    Attributes:
        end: As in `handled`.
        parent: Process number of the command, while it runs.
        prctl: Function of the C library of Linux.
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
    """Block the signals before a fork.

    A signal that reaches the child before it has its own handlers would be lost, and a pool of
    processes would wait for ever.
    """
    if _state.parent is not None:
        signal.pthread_sigmask(signal.SIG_BLOCK, _kinds())


def _unblock() -> None:
    """Unblock the signals after a fork."""
    if _state.parent is not None:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _kinds())


def _become_worker() -> None:
    """Leave the process group in a forked child, and let it end with its parent."""
    if _state.parent is None:
        return
    _replace_handlers(signal.SIG_DFL)
    # signals to the group are for the parent: a worker that is ended may hold a lock of the pool
    os.setpgid(0, 0)
    if _state.prctl is not None:  # otherwise workers would wait for ever for a killed parent
        _state.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != _state.parent:
            os._exit(1)
    _state.parent = os.getpid()
    _unblock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_block, after_in_parent=_unblock, after_in_child=_become_worker)
