"""Flags of `reachlab export` and `reachlab deploy`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from reachlab.cli.flags import GoalFlags, Optional, no_goals
from reachlab.deploy.plant_faults import Faults
from reachlab.deploy.topics import Topics
from reachlab.settings.validation import Checked, Count, Seed


@dataclass(frozen=True)
class Export(Checked):
    """Write a policy into a folder with all that a robot's computer needs."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run directory, or a policy that comes with reachlab, as `panda/precise`; see `reachlab list`."""
    out: Annotated[Path, Optional] = Path("policy")
    """Folder to make; by default policy, here."""
    agent: Annotated[str | None, tyro.conf.arg(metavar="STR", help_behavior_hint="")] = None
    """`trained`, or `hybrid`: a planner beside the policy; by default that among bodies that stay in place."""
    limits: Path | None = None
    """Lowered limits of the joints, the policy.json of an export before: C has them compiled in."""
    goals: GoalFlags = field(default_factory=no_goals)
    """What will be asked for, where that is something else than in training."""
    json: bool = False
    """Print what was written as one JSON object on standard output."""


@dataclass(frozen=True)
class Deploy(Checked):
    """Run an exported policy: as a node of ROS 2 on an arm, or checked in real time against a simulated one."""

    how: Annotated[Literal["check", "ros2"], tyro.conf.Positional]
    """`check`: its controller in a process of its own drives a simulated arm in real time. `ros2`: a node."""
    policy: Annotated[Path, tyro.conf.Positional] = Path("policy")
    """Folder that `reachlab export` wrote."""
    sim: Annotated[str | None, tyro.conf.arg(metavar="STR", help_behavior_hint="")] = None
    """Check: simulator of the arm; by default the run's own."""
    episodes: Count = 20
    """Check: held-out episodes."""
    seed: Seed = 1
    """Check: seed of the goals."""
    over_ros2: bool = False
    """Check: the arm is a node, and the policy's node another process; messages go over DDS."""
    faults: Faults = field(default_factory=Faults)
    trajectory: bool = False
    """Node: publish trajectories of one point, for arms without a forward position controller."""
    joint_names: tuple[str, ...] = ()
    """Node: names of the joints in messages, in the order of `policy.json`, where they are not those."""
    frame: str = ""
    """Node: frame of places in messages, `goal.frame` of policy.json; by default the first that one names. Others are
    not used."""
    topics: Topics = field(default_factory=Topics)
    json: bool = False
    """Check: print the result as one JSON object on standard output."""
