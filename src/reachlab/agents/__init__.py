"""Who acts: the trained policy, and baselines."""

from __future__ import annotations

from dataclasses import dataclass

from reachlab.settings.tables import Lazy, Table


@dataclass(frozen=True)
class AgentEntry(Lazy):
    """An agent of the table: a function that gives actions, see `acting.Agent`.

    Attributes:
        trained: it needs a policy, and is given the observation's picture.
        remembers: it knows more of an episode than its state: a function that gives an `acting.Act` for an environment.
        blind: it looks at nothing; where its actions correct a controller, it is that which comes to the goal.
    """

    trained: bool = False
    remembers: bool = False
    blind: bool = False


AGENTS: dict[str, AgentEntry] = Table(
    {
        "trained": AgentEntry("the trained policy, without noise", "reachlab.agents.acting:trained", trained=True),
        "random": AgentEntry(
            "actions sampled uniformly from their box", "reachlab.agents.baselines:random", blind=True
        ),
        "zero": AgentEntry(
            "actions of zero; where they correct a controller, as joint_residual, what that does alone",
            "reachlab.agents.baselines:zero",
            blind=True,
        ),
        "ik": AgentEntry(
            "inverse kinematics in a closed loop: to the target from where the tool is measured, at every step",
            "reachlab.agents.baselines:ik",
        ),
        "script": AgentEntry(
            "what the task's controller does, as ik: for objects a script without memory",
            "reachlab.agents.baselines:ik",
        ),
        "ik_open": AgentEntry(
            "inverse kinematics without feedback: to the target from where the tool was commanded, whatever is"
            " measured",
            "reachlab.agents.baselines:ik_open",
        ),
        "planner": AgentEntry(
            "a path among bodies, planned by random sampling and followed; needs the extra 'planner'",
            "reachlab.agents.planner:Following",
            remembers=True,
        ),
        "hybrid": AgentEntry(
            "the trained policy, and the planner where the policy would not get through, or comes no nearer",
            "reachlab.agents.hybrid:Hybrid",
            trained=True,
            remembers=True,
        ),
    }
)
"""Agents by name: the trained policy, and what it has to beat. Adding one takes its function and its line here."""
