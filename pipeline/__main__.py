"""`python -m pipeline` is `turtlebag`: the door, which opens before anything heavy is imported."""

import ctypes
import gc
import os
import signal
import sys
from contextlib import suppress

# Imports and graphs make many objects and next to no cycles: looking for those as often as Python does by
# itself costs a tenth of a short command.
GARBAGE_AFTER = 50_000
# Arrays of a megabyte and more go back to the system when they are done with. By itself the C library raises
# that limit to the largest array there was, and maps hold on to a hundred megabytes that nobody uses.
M_MMAP_THRESHOLD, GIVEN_BACK_BYTES = -3, 1 << 20


def run() -> int:
    """The console script. Ctrl-C during the imports ends quietly too."""
    gc.set_threshold(GARBAGE_AFTER)
    with suppress(AttributeError):  # a C library without this knob
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, GIVEN_BACK_BYTES)
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, lambda number, frame: os._exit(128 + number))
    try:
        from turtlebag.pipeline.cli.main import main
        from turtlebag.pipeline.terminal.messages import tell_traceback
    except ImportError as error:
        from turtlebag.pipeline.setup.missing_package import missing_package

        print(missing_package(error), file=sys.stderr)
        return 2

    sys.excepthook = tell_traceback
    if ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return main()


if __name__ == "__main__":
    sys.exit(run())
