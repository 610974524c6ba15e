"""Parameters of tests that take long to compile."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def tried(values: Iterable[Any], quick: Collection[Any]) -> list[Any]:
    """Parameters of which `make test` tries those in `quick`, and `make slow` the others."""
    return [value if value in quick else pytest.param(value, marks=pytest.mark.slow) for value in values]
