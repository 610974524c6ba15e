"""Make the parts of pages anew: `make tables`."""

from __future__ import annotations

from pathlib import Path

from builder import renewed

for page in sorted(Path(__file__).parents[1].glob("*.md")):
    before = page.read_text(encoding="utf-8")
    if (after := renewed(before)) != before:
        page.write_text(after, encoding="utf-8")
        print(f"made anew: docs/{page.name}")  # noqa: T201
