"""Runs a suite and prints its rows: `python -m benchmarks precise --markdown`, from the project's folder."""

from __future__ import annotations

import argparse
import json
import sys

from benchmarks import SUITES
from reachlab.bench import run_suite
from reachlab.bench.table import to_markdown
from reachlab.settings.validation import InputError


def main() -> int:
    """Exit status of the command; 2 where the suite does not exist."""
    about = "\n".join(f"  {name:14}{suite.summary}" for name, suite in SUITES.items())
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", epilog=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("suite", help="name of the suite")
    parser.add_argument("--markdown", action="store_true", help="print a table instead of JSON")
    arguments = parser.parse_args()
    try:
        rows = run_suite(arguments.suite, SUITES)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    print(to_markdown(rows) if arguments.markdown else json.dumps(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
