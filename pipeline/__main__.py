"""`python -m pipeline` is `turtlebag`: the door, which opens before anything heavy is imported."""

import gc
import os
import signal
import sys

# Imports and graphs make many objects and next to no cycles: looking for those as often as Python does by
# itself costs a tenth of a short command.
GARBAGE_AFTER = 50_000


def run() -> int:
    """The console script. Ctrl-C during the imports ends quietly too."""
    gc.set_threshold(GARBAGE_AFTER)
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, lambda number, frame: os._exit(128 + number))
    try:
        from pipeline.cli import main
    except ImportError as error:
        from pipeline.missing import missing_package

        print(missing_package(error), file=sys.stderr)
        return 2

    if ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return main()


if __name__ == "__main__":
    sys.exit(run())
