"""`python -m turtlebag` is `turtlebag`."""

import sys

from turtlebag.pipeline.__main__ import run

sys.exit(run())
