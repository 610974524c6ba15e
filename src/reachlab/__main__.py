"""`python -m reachlab` is the command line."""

import sys

from reachlab.cli.main import main

sys.exit(main())
