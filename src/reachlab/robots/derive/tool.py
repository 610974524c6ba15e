"""Which frame of a model is the arm's tool, where nobody says it."""

from __future__ import annotations

import re
from collections.abc import Sequence

import mujoco

TOOL_NAMES = (
    *("attachment", "tool0", "tcp", "tool center point", "ee", "eef", "end effector", "endeffector", "gripper frame"),
    *("grasp", "grasptarget", "grip", "pinch", "flange", "tool", "hand", "gripper"),
)
"""Words that follow each other in the name of a tool frame, the surest first: ROS-Industrial's `tool0` and `flange`,
MuJoCo Menagerie's `attachment_site`, and what makers call theirs."""

GRIPPER_WORDS = frozenset({"gripper", "finger", "fingers", "jaw", "knuckle", "thumb", "hand", "claw"})
"""A joint with such a word in its name moves a gripper, not the arm."""

SHORTEST_ARM = 3
"""Joints from which on a chain that branches is an arm with a gripper; before, a body with several arms."""

GROUPS_BACK = 2
"""Rigid parts, from the chain's end, in which a frame with a tool's name is looked for: the last joint may be that of a
gripper whose name does not say so."""


def find_tools(model: mujoco.MjModel, mimics: Sequence[str] = (), base: int = 0) -> list[str]:
    """The frames at the ends of the chains, the longest first, that are named like a tool, else a chain's last body.

    There are several where there are several arms, and none where nothing that is moved has a name.

    Args:
        model: the compiled model.
        mimics: joints that follow others, which are a gripper's.
        base: body below which the chain lies.
    """
    tree = _Tree(model, frozenset(mimics))
    chains = sorted((chain for chain in tree.chains(base) if chain), key=len, reverse=True)
    arms = [chain for chain in chains if len(chain) >= SHORTEST_ARM] or chains
    return [name for name in map(tree.tool, arms) if name]


class _Tree:
    """The bodies of a model, with the joints of an arm that move them."""

    def __init__(self, model: mujoco.MjModel, mimics: frozenset[str]) -> None:
        self._model = model
        self._children: dict[int, list[int]] = {body: [] for body in range(model.nbody)}
        for body in range(1, model.nbody):
            self._children[int(model.body_parentid[body])].append(body)
        kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        moving = [
            int(model.jnt_type[joint]) in kinds
            and model.joint(joint).name not in mimics
            and not GRIPPER_WORDS & set(words(model.joint(joint).name))
            for joint in range(model.njnt)
        ]
        self._jointed = [
            any(moving[first : first + count])
            for first, count in zip(model.body_jntadr, model.body_jntnum, strict=True)
        ]

    def chains(self, body: int, depth: int = 0) -> list[list[int]]:
        """Chains of moved bodies from a body, `depth` joints from the base, each up to where a gripper branches."""
        own = [body] * (self._jointed[body] and body != 0)
        depth += len(own)
        longer = [found for child in self._children[body] if any(found := self.chains(child, depth))]
        if not longer or (len(longer) > 1 and depth >= SHORTEST_ARM):
            return [own]
        return [own + chain for found in longer for chain in found]

    def tool(self, chain: list[int]) -> str:
        """The tool frame at the end of a chain of moved bodies; empty where it has no name."""
        for last in reversed(chain[-GROUPS_BACK:]):
            if ranks := {name: rank for name in self._frames(last) if (rank := _rank(name)) is not None}:
                return min(ranks, key=ranks.__getitem__)
        return str(self._model.body(chain[-1]).name)

    def _frames(self, body: int) -> list[str]:
        """Sites and bodies that are fixed to a moved body."""
        rigid = [body]
        for one in rigid:
            rigid += [child for child in self._children[one] if not self._model.body_jntnum[child]]
        sites = [self._model.site(i).name for i in range(self._model.nsite) if int(self._model.site_bodyid[i]) in rigid]
        bodies = [self._model.body(one).name for one in rigid]
        return [str(name) for name in (*sites, *bodies) if name]


def words(name: str) -> list[str]:
    """The words of a name, in small letters: `Link7_toolPoint` has `link7`, `tool` and `point`."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])[0-9]*|[A-Z]?[a-z]+[0-9]*|[0-9]+", name)]


def like_a_tool(name: str) -> bool:
    """Whether a frame is named like a tool."""
    return _rank(name) is not None


def _rank(name: str) -> int | None:
    """Place in `TOOL_NAMES` of the first entry whose words stand in a name."""
    own = f" {' '.join(words(name))} "
    return next((rank for rank, wanted in enumerate(TOOL_NAMES) if f" {wanted} " in own), None)
