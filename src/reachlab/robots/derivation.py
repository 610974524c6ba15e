"""Home and boxes of an arm that nobody states, derived once and kept in the user's cache."""

from __future__ import annotations

import logging

import numpy as np

from reachlab.robots.arm import Arm
from reachlab.robots.cache import kept
from reachlab.robots.model_file import ModelFile
from reachlab.robots.self_contact import untouching
from reachlab.robots.workspace import Derived, derive

logger = logging.getLogger(__name__)

VERSION = 8
"""Of the derivation: what an older one left in the cache is derived again."""


def derived(file: ModelFile, arm: Arm, speed: tuple[float, ...]) -> Derived:
    """Home and boxes of an arm; from the cache if they were derived before."""
    asked = (VERSION, file.digest, arm.tool, arm.isolation.joints, arm.chain, arm.home, speed)

    def find() -> Derived:
        logger.warning("reachlab: finding home and workspace of %s: a few seconds, once.", file.file.name)
        return derive(arm.chain, np.array(speed), arm.base, arm.home, untouching(file, arm))

    return kept("robots", asked, find, Derived, Derived._asdict)
