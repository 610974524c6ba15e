"""`python -m reachlab` is the command line."""

import sys

from reachlab.cli import main

sys.exit(main())
