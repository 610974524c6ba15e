"""Task `clutter`: hold a point among obstacles without touching anything, under full dynamics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from reachlab.settings.preset_record import Preset, Rule
from reachlab.settings.validation import NonNegative, Positive, Range, choose
from reachlab.tasks.precise import Precise

if TYPE_CHECKING:
    from reachlab.tasks.task import Task

Few = Annotated[int, Range(0, 16)]
"""A number of obstacles."""


AROUND_FURNITURE = 250
"""Steps of an episode in which there is no straight way."""

IMITATED = Rule(
    lambda c: c.rules.action == "heading",
    {
        "observation": "ways",
        "num_envs": 96,
        "rollout_steps": 25,
        "total_steps": 75 * 96 * 25,
        "anneal_steps": 75 * 96 * 25,
        "hidden": (),
        "learning_rate": 1e-3,
        "final_learning_rate": 3e-5,
        "max_grad_norm": 1.0,
        "initial_std": 0.1,
    },
)
"""A policy that imitates planned ways."""


@dataclass(frozen=True)
class Clutter(Precise):
    """Settings of holding a point among obstacles."""

    preset: ClassVar[Preset] = replace(
        Precise.preset,
        loop=replace(Precise.preset.loop, total_steps=3_000_000),
        learner=replace(Precise.preset.learner, learning_rate=5e-4, anneal_steps=3_000_000, initial_std=0.3),
        ppo=replace(Precise.preset.ppo, gamma=0.98),
        rules=(*Precise.preset.rules, IMITATED),
    )
    evaluated: ClassVar[tuple[str, ...]] = ("scene", "obstacles", "body_speed", *Precise.evaluated)

    observation: str = "clutter"
    reward: str = "closeness"
    max_steps: Annotated[int, Range(1, 10**5)] = 150
    """An episode is truncated on this step; where it is left out, and the scene is another than balls, on step 250."""
    joint_scale: Positive | None = None
    closeness_scale: Positive = 0.02
    effort_weight: NonNegative = 0.001
    scene: tuple[str, ...] = ("balls",)
    """What is beside the arm: balls, random balls, capsules and boxes; moving, balls and capsules that cross its way;
    or bin, posts, shelf, table and wall, one or some, in which no way is straight; or a JSON file of bodies."""
    obstacles: tuple[Few, Few] = (0, 4)
    """Fewest and most obstacles of an episode of scene balls."""
    body_speed: Annotated[float, Range(0.1, 0.5)] = 0.3
    """How fast the bodies of scene moving are [m/s]."""
    end_on_contact: bool = True
    """Touching anything ends the episode, in failure."""

    @classmethod
    def task(cls) -> Task:
        """The flange is held at a point among obstacles."""
        from reachlab.tasks.given_goals import place_free_point
        from reachlab.tasks.scenes import sampling
        from reachlab.tasks.task import Control

        return replace(
            super().task(),
            # A residual action of 1 can stop the arm; with the dampers, lead it round.
            control=Control("joint_servo", residual_gain=1.0, dampers=True),
            goal_box=sampling.goal_box,
            sample_goal=sampling.sample_goal,
            place=place_free_point,
            scene=sampling.scene,
            sample_bodies=sampling.sample_bodies,
            move=sampling.move,
            prepare=sampling.prepare,
            sample=sampling.sample,
            needs=frozenset({"contacts"}),
            asks=_asks,
            succeeds=_succeeds,
        )

    def __post_init__(self) -> None:
        """Give ways round furniture the time that they take."""
        super().__post_init__()
        scene = tuple(str(Path(name).absolute()) if name.endswith(".json") else name for name in self.scene)
        object.__setattr__(self, "scene", scene)
        if self.scene != ("balls",) and self.max_steps == Clutter.max_steps:
            object.__setattr__(self, "max_steps", AROUND_FURNITURE)

    def contradiction(self) -> str | None:
        """What of these settings cannot be together."""
        from reachlab.tasks.scenes.kinds import KINDS

        fewest, most = self.obstacles
        if fewest > most:
            return f"obstacles has a fewest number above the most, {fewest} against {most}: exchange them."
        if not self.scene or {"balls", "moving"} & {*self.scene[1:], *self.scene[:-1]}:
            return f"scene {' '.join(self.scene)!r} cannot be: name balls or moving alone, or others, one or some."
        for name in self.scene:
            if not name.endswith(".json"):
                choose("scene", name, ["balls", "moving", *KINDS])
        if self.scene != ("balls",) and self.obstacles != Clutter.obstacles:
            return f"obstacles are those of scene balls, not of {' '.join(self.scene)}: leave them out."
        if self.scene != ("moving",) and self.body_speed != Clutter.body_speed:
            return f"body_speed is that of scene moving, not of {' '.join(self.scene)}: leave it out."
        if self.targets != "box":
            return "goals among obstacles are in a box: set targets to 'box'."
        return super().contradiction()

    gives = frozenset({"joints", "bodies"})
    """What there is to observe and to control by."""

    @property
    def ends_on_contact(self) -> bool:
        """Whether touching anything ends an episode."""
        return self.end_on_contact


def _asks(rules: Clutter, period: float) -> str:
    from reachlab.tasks import reach

    fewest, most = rules.obstacles
    known: dict[tuple[str, ...], str] = {
        ("balls",): f"there are {fewest} to {most} obstacles",
        ("moving",): f"balls and capsules cross the arm's way at {rules.body_speed:g} m/s",
    }
    beside = known.get(rules.scene, f"there are scenes of {', '.join(rules.scene)}")
    return f"{reach.asks(rules, period)}; {beside}" + ", and nothing may be touched" * rules.end_on_contact


def _succeeds(rules: Clutter, period: float) -> str:
    from reachlab.tasks import reach

    return reach.succeeds(rules, period) + ", and the arm has touched nothing" * rules.end_on_contact
