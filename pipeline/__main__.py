"""`python -m pipeline` is `turtlebag`: the door, which opens before anything heavy is imported."""

import os
import signal
import sys


def run() -> int:
    """The console script. Ctrl-C during the imports ends quietly too."""
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, lambda number, frame: os._exit(128 + number))
    from pipeline.cli import main

    if ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return main()


if __name__ == "__main__":
    sys.exit(run())
