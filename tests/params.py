"""Parameters of tests that take long to compile."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import pytest


def tried(values: Collection[Any], quick: Collection[Any]) -> list[Any]:
    """Parameters of which `make test` tries those in `quick`, and `make slow` the others."""
    assert set(quick) <= set(values), "a parameter that is not there would leave nothing to `make test`"
    return [value if value in quick else pytest.param(value, marks=pytest.mark.slow) for value in values]
