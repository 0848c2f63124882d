"""``bench`` and ``python -m bench``: interrupted, from the first import on, they end with status 130."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

from bench.core.words.exceptions import INTERRUPTED, MACHINE
from bench.core.words.plain_output import find_lost, let_streams_write_all


def main() -> None:
    """Run the command line of this process and exit with its status."""
    os.environ.setdefault("RUST_LOG", "error")  # rerun warns of what it drops when interrupted
    for name in (
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
    ):  # waking threads for 6 x 6 costs 300 times the work
        os.environ.setdefault(name, "1")
    numbers = (signal.SIGINT, signal.SIGTERM)
    for number in numbers:
        if signal.getsignal(number) != signal.SIG_IGN:  # ignored: started in the background
            signal.signal(number, _leave)
    let_streams_write_all()
    from bench.cli import command_line

    status = command_line.main()
    if (lost := find_lost()) is not None:
        sys.stderr.write(f"error: standard output: {lost.strerror}; not all that was printed is there\n")
        status = max(status, MACHINE)
    for number in numbers:  # all is done; Python itself ends
        signal.signal(number, signal.SIG_IGN)
    if status == INTERRUPTED:  # Python would end by SIGINT if the interruption came within an exec()
        sys.stderr.flush()
        os._exit(status)
    sys.exit(status)


def _leave(number: int, frame: FrameType | None) -> None:
    """End the process at once: nothing has been begun that would have to be taken back."""
    os.write(2, b"error: interrupted\n")
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
