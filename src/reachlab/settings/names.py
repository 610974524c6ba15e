"""Names that the command line's help lists, of functions in modules that are too heavy for it to load."""

from __future__ import annotations

AGENTS = ("trained", "random", "zero", "ik", "ik_open")
"""Agents, in the order of `evaluation.AGENTS`."""
