"""A task whose functions are told by name where they fail or give something else than what is needed."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from reachlab.control.bodies import absent
from reachlab.control.situation import Goal
from reachlab.settings.validation import InputError
from reachlab.tasks.answers import answer, form
from reachlab.tasks.task import Errors, Task

POINT = np.zeros(3, np.float32)
"""Of the form of any point."""


def checked(task: Task, name: str) -> Task:
    """The task of the settings called `name`; what its functions give is looked at where they are called.

    Raises:
        InputError: one is no function; and from a function: it fails, or gives something else.
    """
    functions = {}
    for field in dataclasses.fields(task):
        if "Callable" in str(field.type):
            if not callable(given := getattr(task, field.name)):
                raise InputError(f"{name}'s task needs a function as `{field.name}`, got {given!r}.")
            forms = FORMS.get(field.name, lambda *_: ())
            functions[field.name] = functools.partial(_call, f"{name}'s `{field.name}`", given, forms)
    return dataclasses.replace(task, **functions)


def _call(who: str, function: Callable[..., Any], forms: Callable[..., tuple[str, ...]], *arguments: Any) -> Any:
    given = answer(who, function, *arguments)
    allowed = forms(given, *arguments)
    if allowed and (got := form(given)) not in allowed:
        raise InputError(f"{who} gives {got}: it must give {' or '.join(allowed)}.")
    return given


def _box(given: Any, *_: Any) -> tuple[str, ...]:
    corners = isinstance(given, tuple | list) and [jnp.shape(corner) for corner in given] == [POINT.shape] * 2
    return (form(given),) if corners else ("two corners, (float[3], float[3])",)


def _goal(given: Any, *_: Any) -> tuple[str, ...]:
    """A goal at a position; what else is asked for is up to the task."""
    placed = isinstance(given, Goal)
    return (form(dataclasses.replace(given, position=POINT)) if placed else "a Goal",)


def _bodies(_: Any, setup: Any, *__: Any) -> tuple[str, ...]:
    return (form(absent(setup.task.scene(setup).bodies)),)


def _errors(_: Any, __: Any, now: Any) -> tuple[str, ...]:
    count = now.q.shape[:-1]
    distance = np.zeros(count)
    return tuple(form(Errors(distance, np.zeros(angles))) for angles in ((*count, 0), count))


def _measured(kind: str) -> Callable[..., tuple[str, ...]]:
    """One number for each distance of the errors."""
    return lambda _, __, errors: (kind + str([*jnp.shape(errors.distance)]),)


FORMS: dict[str, Callable[..., tuple[str, ...]]] = {
    "goal_box": _box,
    "sample_goal": _goal,
    "sample_start": lambda _, setup, *__: (f"float[{setup.robot.chain.n}]",),
    "sample_bodies": _bodies,
    "asks": lambda *_: ("str",),
    "succeeds": lambda *_: ("str",),
    "scene": lambda *_: ("Scene",),
    "vary": lambda _, __, ___, *before: (form(before),),
    "move": lambda _, __, goal, bodies, ___: (form((goal, bodies)),),
    "known": lambda _, __, goal: (form(goal),),
    "errors": _errors,
    "gap": _measured("float"),
    "near": _measured("bool"),
    "update": lambda _, __, progress, *___: (form(progress),),
    "counted": lambda _, errors, __: (form(errors),),
}
"""Forms of what functions of a task may give, of it and of their arguments."""
