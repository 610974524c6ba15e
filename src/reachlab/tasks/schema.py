"""Observations as records: their terms, and the schema of arrays that they make."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from reachlab.control.situation import Situation
from reachlab.settings.validation import InputError
from reachlab.tasks.task import Bounds, TaskSetup

SIZE = 84
"""Height and width of a picture [pixels]; the tutorial's."""

Observed = Any
"""An observation: a vector `[..., k]`, a picture `[..., SIZE, SIZE]` uint8, or a dict of them by name."""

GOALS = ("achieved_goal", "desired_goal")
"""Names of the last fields of an observation in the form of Gymnasium-Robotics' `GoalEnv`."""


@dataclass(frozen=True)
class Term:
    """A part of an observation.

    Attributes:
        name: in the schema.
        unit: of its numbers.
        value: the term `[B, k]` in a situation; of the camera `[B, SIZE, SIZE]` uint8.
        bounds: of its numbers `[k]`.
        constant: which of them never change `[k]`; by default none.
        picture: it is the camera's picture.
        row: of rows whose order means nothing, as of bodies, how many numbers one has.
    """

    name: str
    unit: str
    value: Callable[[TaskSetup, Situation], Any]
    bounds: Callable[[TaskSetup], Bounds]
    constant: Callable[[TaskSetup], np.ndarray] | None = None
    picture: bool = False
    row: int = 0


@dataclass(frozen=True)
class Field:
    """A term as the policy gets it: name, unit, shape, bounds, and which numbers never change; hashable.

    Bounds and constants are `[k]`, or of a single number for all pixels of a picture.
    """

    name: str
    unit: str
    shape: tuple[int, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    constant: tuple[bool, ...]
    picture: bool
    row: int = 0

    @property
    def bounds(self) -> Bounds:
        """Lower and upper bounds in the field's own shape and type."""
        kind = np.uint8 if self.picture else np.float32
        low, high = (np.broadcast_to(np.array(side, kind), self.shape).copy() for side in (self.low, self.high))
        return low, high


@dataclass(frozen=True, eq=False)
class Schema:
    """What an observation is made of, in order.

    Without a picture the observation is one vector, all fields joined; a picture alone is an array; with more than that
    it is a dict of the fields by name. One that ends in `GOALS` is a dict of these and of the others joined, called
    `observation`.
    """

    fields: tuple[Field, ...]

    def __eq__(self, other: object) -> bool:
        """Whether both describe the same; JAX asks at every call of a compiled function, mostly of one and the same."""
        return self is other or (isinstance(other, Schema) and self.fields == other.fields)

    def __hash__(self) -> int:
        """Hash, computed once for the same reason."""
        return self._hash

    @functools.cached_property
    def _hash(self) -> int:
        return hash(self.fields)

    @functools.cached_property
    def pictures(self) -> tuple[Field, ...]:
        """Fields that are pictures."""
        return tuple(field for field in self.fields if field.picture)

    @functools.cached_property
    def vectors(self) -> tuple[Field, ...]:
        """Fields that are neither pictures nor rows."""
        return tuple(field for field in self.fields if not field.picture and not field.row)

    @functools.cached_property
    def row(self) -> int:
        """Numbers of a row, where the last field is made of rows, of which there may be any number; else 0."""
        return self.fields[-1].row

    @functools.cached_property
    def has_goals(self) -> bool:
        """Whether it is in the form of a `GoalEnv`."""
        return tuple(field.name for field in self.fields[-2:]) == GOALS

    @property
    def vector_size(self) -> int:
        """Numbers in all vectors together."""
        return sum(field.shape[0] for field in self.vectors)

    def join(self, values: Mapping[str, Any]) -> Observed:
        """The observation of its fields' values by name."""
        if self.pictures:
            return values[self.fields[0].name] if len(self.fields) == 1 else dict(values)
        parts = [values[field.name] for field in self.fields]
        if self.has_goals:
            return {"observation": _concatenated(parts[:-2]), **dict(zip(GOALS, parts[-2:], strict=True))}
        return _concatenated(parts)

    def split(self, observation: Observed) -> tuple[Any, Any]:
        """Picture and vector `[..., k]` of an observation, each None where it has none; rows are left out."""
        if self.has_goals:
            return None, _concatenated([observation["observation"], *(observation[name] for name in GOALS)])
        if not self.pictures:
            return None, observation[..., : self.vector_size] if self.row else observation
        if not self.vectors:
            return observation, None
        parts = [observation[field.name] for field in self.vectors]
        return observation[self.pictures[0].name], _concatenated(parts)

    def rows(self, observation: Observed) -> Any:
        """Rows `[..., K, row]` of an observation; None where it has none."""
        if not self.row:
            return None
        numbers = observation[..., self.vector_size :]
        return numbers.reshape(*numbers.shape[:-1], -1, self.row)

    @property
    def bounds(self) -> tuple[Any, Any]:
        """Lower and upper bounds in the form of an observation."""
        low, high = ({field.name: field.bounds[side] for field in self.fields} for side in (0, 1))
        return self.join(low), self.join(high)


def _concatenated(parts: Sequence[Any]) -> Any:
    module: Any = np if isinstance(parts[0], np.ndarray) else jnp
    return parts[0] if len(parts) == 1 else module.concatenate(parts, axis=-1)


@dataclass(frozen=True)
class Observation:
    """An observation design.

    Attributes:
        summary: what its terms are, in a sentence.
        terms: what it is made of.
        needs: what the task has to give for them, of `reachlab.tasks.WORDS`.
    """

    summary: str
    terms: tuple[Term, ...]
    needs: frozenset[str] = frozenset()

    @property
    def pictured(self) -> bool:
        """Whether the camera's picture is in it."""
        return any(term.picture for term in self.terms)

    @property
    def gives(self) -> frozenset[str]:
        """What is known by it, of `reachlab.tasks.WORDS`: `places`, where all of them are told, or a `picture`."""
        return frozenset({"picture" if self.pictured else "places"})

    def schema(self, setup: TaskSetup) -> Schema:
        """Its schema on an arm.

        Raises:
            InputError: there are no terms, two of one name, or a term's bounds are none.
        """
        if not self.terms:
            raise InputError(f"the observation {self.summary!r} has no terms: give it at least one.")
        names = [term.name for term in self.terms]
        if len(set(names)) < len(names):
            raise InputError(f"the terms of the observation {self.summary!r} are {', '.join(names)}: name each once.")
        return Schema(tuple(_field(term, setup) for term in self.terms))


def _field(term: Term, setup: TaskSetup) -> Field:
    try:
        low, high = (np.asarray(side, float) for side in term.bounds(setup))
    except InputError:
        raise
    except (TypeError, ValueError):
        raise InputError(f"the bounds of term {term.name!r} must be two arrays of numbers, the lower first.") from None
    if low.ndim != 1 or low.shape != high.shape or not (low <= high).all():
        raise InputError(
            f"the bounds of term {term.name!r} must be as many numbers [k] on both sides, none above the other, got"
            f" {low.tolist()} and {high.tolist()}."
        )
    constant = np.zeros(low.shape, bool) if term.constant is None else term.constant(setup)
    return Field(
        name=term.name,
        unit=term.unit,
        shape=(SIZE, SIZE) if term.picture else low.shape,
        low=tuple(low.tolist()),
        high=tuple(high.tolist()),
        constant=tuple(constant.tolist()),
        picture=term.picture,
        row=term.row,
    )
