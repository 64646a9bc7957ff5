"""`python -m pipeline` is `turtlebag`."""

import sys

from pipeline.cli import main

sys.exit(main())
