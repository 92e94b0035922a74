"""The ends of the process `handbench`: streams that cannot fail a command, and signals that stop it in order."""

from __future__ import annotations

import atexit
import io
import os
import select
import signal
import sys
from collections.abc import Callable, Iterable
from types import FrameType
from typing import Any


def live(main: Callable[..., int]) -> int:
    """Run `main` between streams and signals of ours, and return the exit code; what was printed is out by then."""
    stops = Stops()
    output = open_streams()
    try:
        code = main(stops=stops)
    except SystemExit as end:  # of argparse, which has told why
        code = end.code if isinstance(end.code, int) else 2
    atexit._run_exitfuncs()
    sys.stdout.flush()
    if output.trouble is not None and not isinstance(output.trouble, BrokenPipeError):
        print(
            f"handbench: standard output cannot be written ({output.trouble.strerror}); what was printed is cut off",
            file=sys.stderr,
        )
        code = code or 2
    sys.stderr.flush()
    return code


class Output(io.RawIOBase):
    """Standard output or error as bytes. What cannot be written is dropped, and `trouble` says why: a reader that has
    left and a full disk are no reason to stop a run, nor to blame the method that happened to print."""

    def __init__(self, descriptor: int) -> None:
        self.trouble: OSError | None = None
        self._descriptor = descriptor

    def write(self, data: Any) -> int:
        left = memoryview(data).cast("B")
        length = len(left)
        while left and self.trouble is None:
            try:
                left = left[os.write(self._descriptor, left) :]
            except BlockingIOError:  # a terminal or pipe that was set not to wait
                select.select([], [self._descriptor], [])
            except OSError as error:
                self.trouble = error
        return length

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._descriptor

    def isatty(self) -> bool:
        return os.isatty(self._descriptor)


def open_streams() -> Output:
    """Make sys.stdout and sys.stderr such streams and return the first; text that their encoding lacks is escaped."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:  # closed: else the next file that is opened would become standard output
            os.open(os.devnull, os.O_RDWR)
    outputs = Output(1), Output(2)
    sys.stdout, sys.stderr = map(_text, outputs, (sys.stdout, sys.stderr))
    return outputs[0]


class _Text(io.TextIOWrapper):
    """Text that stays open: a method that closes what it prints to must not take our answer along."""

    def close(self) -> None:
        self.flush()


def _text(output: Output, before: Any) -> io.TextIOWrapper:
    encoding = getattr(before, "encoding", None) or "utf-8"
    by_line = output.fileno() == 2 or output.isatty()
    return _Text(io.BufferedWriter(output), encoding, "backslashreplace", line_buffering=by_line)


class Stops:
    """Signals that ask the process to end: each becomes a KeyboardInterrupt, so that files and processes are left in
    order, and `signal` remembers it, since libraries make errors of their own of it."""

    def __init__(self, names: Iterable[str] = ("SIGINT", "SIGTERM", "SIGHUP")) -> None:
        self.signal: int | None = None
        for name in names:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) != signal.SIG_IGN:  # nohup ignores some
                signal.signal(number, self._stop)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self.signal = number
        raise KeyboardInterrupt
