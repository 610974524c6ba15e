"""Observations: designs made of terms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax.numpy as jnp

from reachlab.control.situation import Situation
from reachlab.settings.tables import Table
from reachlab.settings.validation import InputError
from reachlab.tasks.answers import answer
from reachlab.tasks.body_terms import AROUND, CLUTTER, WAYS
from reachlab.tasks.object_terms import GRIPPED, OBJECT, STRUCK
from reachlab.tasks.schema import Observation, Observed
from reachlab.tasks.task import TaskSetup
from reachlab.tasks.terms import (
    ACHIEVED_AND_DESIRED,
    ARM,
    GOAL,
    IMAGE,
    LAST_ACTION,
    POSE,
    SEEN,
    STATE,
    TOOL,
    TRACK,
    WRIST,
)

OBSERVATIONS: dict[str, Observation] = Table(
    {
        "target": Observation("the target's position [m]", (GOAL,)),
        "target+tool": Observation("the target's and the tool's positions [m]", (GOAL, TOOL)),
        "state": Observation(
            "joints, their speeds and lag, tool, target, the way between them far and near, and the last action", STATE
        ),
        "glimpse": Observation("as state, and whether the target is seen", (*STATE, SEEN)),
        "pose": Observation(
            "as state, and the orientations of tool and target, the turn between them far and near, and how far the"
            " joints are from where they have the target",
            POSE,
            needs=frozenset({"orientation", "joints"}),
        ),
        "track": Observation("as state, and the velocity of the target", TRACK, needs=frozenset({"velocity"})),
        "clutter": Observation(
            "as state, how far the joints are from where they have the target, and how near bodies are to each link and"
            " to points of a grid",
            CLUTTER,
            needs=frozenset({"joints", "bodies"}),
        ),
        "ways": Observation(
            "joints, tool, target, how far the joints are from where they have it, and the bodies beside the arm, each"
            " by its place, size and axes",
            WAYS,
            needs=frozenset({"joints", "bodies"}),
        ),
        "clutter_pose": Observation(
            "as pose, and how near bodies are to each link and to points of a grid",
            (*POSE, *AROUND),
            needs=frozenset({"orientation", "joints", "bodies"}),
        ),
        "push": Observation(
            "joints, their speeds and lag, tool, target and last action, and the object's place beside tool and target",
            OBJECT,
            needs=frozenset({"object"}),
        ),
        "lift": Observation(
            "as push, and how wide the gripper is open and how firmly it closes",
            GRIPPED,
            needs=frozenset({"object", "gripper"}),
        ),
        "slide": Observation("as push, and how fast the object slides", STRUCK, needs=frozenset({"object"})),
        "image": Observation("a camera's picture, 84 × 84 grey", (IMAGE,)),
        "goal": Observation(
            "the tool's position, achieved_goal and desired_goal [m], as a dict: the form of a GoalEnv",
            (TOOL, *ACHIEVED_AND_DESIRED),
        ),
        "goal+state": Observation(
            "joints, their speeds and lag, tool and last action, achieved_goal and desired_goal [m], as a dict",
            (*ARM, LAST_ACTION, *ACHIEVED_AND_DESIRED),
        ),
        "image+tool": Observation("a camera's picture and the tool's position [m], as a dict", (IMAGE, TOOL)),
    }
)
"""Observation designs by name."""


def design_of(rules: Any) -> Observation:
    """The observation design that rules name; where they ask for the wrench that is its first term."""
    design = OBSERVATIONS[rules.observation]
    return replace(design, terms=(WRIST, *design.terms), needs=design.needs | {"wrench"}) if rules.wrench else design


def observe(setup: TaskSetup, now: Situation) -> Observed:
    """Observation of a situation, in the form that `Schema` describes.

    Raises:
        InputError: a term that was added fails, or gives something else than its bounds say.
    """
    design = design_of(setup.rules)
    schema, values = design.schema(setup), dict[str, Any]()
    for term, field in zip(design.terms, schema.fields, strict=True):
        who = f"observation {setup.rules.observation!r}, term {term.name!r}"
        value, asked = answer(who, term.value, setup, now), (*now.q.shape[:-1], *field.shape)
        if jnp.shape(value) != asked and not term.row:
            raise InputError(
                f"{who} gives numbers in shape {jnp.shape(value)}: by its bounds they are {asked}, with the"
                " environments in front."
            )
        whole = not field.picture and not jnp.issubdtype(jnp.result_type(value), jnp.floating)
        values[term.name] = jnp.asarray(value, jnp.float32) if whole else value
    return schema.join(values)
