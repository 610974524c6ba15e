"""What a controller computes, as programs: traced from the functions that training uses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, ShapeDtypeStruct

from reachlab.agents.policy import Memory, Policy
from reachlab.control.bodies import Bodies
from reachlab.control.motion_limits import Motion
from reachlab.control.situation import WRENCH, Goal
from reachlab.emit.program import Program
from reachlab.emit.tracing import trace
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvFunctions, EnvState
from reachlab.robots.kinematics.forward import Pose, forward_kinematics
from reachlab.sims.simulator import Begin, SimState
from reachlab.tasks.judging import judge as judged
from reachlab.tasks.schema import SIZE

GOAL, BODIES, MOTION = "goal_", "bodies_", "motion_"
"""Begins of the names of inputs that are parts of the goal, of the bodies and, in a page, of the commands' motion."""

MEMORY, AFTER = "memory", "wanted_memory"
"""Names of what was remembered, as an input, and of what is remembered then, as a result."""

FELT = "wrench"
"""Name of the wrench that is measured at the wrist, as an input."""

KEPT = "kept_"
"""Begin of the names of what a task keeps of the steps before, to judge."""

Shapes = dict[str, ShapeDtypeStruct]


@dataclass(frozen=True)
class Behaviour:
    """Programs of a policy's controller.

    Attributes:
        inputs: names and shapes of what a decision is made of.
        decide: action `[a]` and command `[m]`, and what is remembered then, of what is measured `[m]`, the goal, the
            last command and action, and what was remembered.
        tool: position `[3]` m and quaternion `[4]` wxyz of the tool, of what is measured.
        place: the goal put at a position and in an orientation with joints that have it, and whether there are any;
            None where goals need no joints.
        judge: what the task makes of what is measured: distance and angle from the goal, both as one number, whether
            these are near enough and whether that is a success, and what of it counts later; None where a picture
            alone shows it.
        begun: what counts later at the begin of an episode, by name.
    """

    inputs: dict[str, list[int]]
    decide: Program
    tool: Program
    place: Program | None
    judge: Program | None
    begun: dict[str, list[float]]

    @property
    def programs(self) -> list[Program]:
        """All of them."""
        return [one for one in (self.decide, self.tool, self.place, self.judge) if one is not None]


def behaviour(env: Env, policy: Policy, constants: Mapping[str, np.ndarray]) -> Behaviour:
    """Programs of a policy in an environment, whose constants are named as `constants` names them.

    Raises:
        InputError: an observation, an action, a controller or a task computes what cannot be printed.
    """
    functions, robot = as_measured(env.functions), env.setup.robot
    like = example_state(functions)
    shapes, goal = decision_inputs(env, like), _parts(like.goal)

    def decide(**given: Array) -> dict[str, Array]:
        state = measured_state(functions, like, given)
        picture = given["picture"][None] if "picture" in given else None
        _, action, command, memory = decision(functions, policy, state, picture)
        return {"action": action[0], "wanted": command[0]} | remembered_as(AFTER, memory)

    def tool(q: Array) -> dict[str, Array]:
        return forward_kinematics(robot.chain, q[: robot.chain.n])._asdict()

    def place(position: Array, near: Array, **given: Array) -> dict[str, Array]:
        before = goal_of(like, {GOAL + "joints": jnp.array(robot.home), GOAL + "position": position})
        turned = given.get("quaternion", jnp.array(robot.held_quaternion))
        placed, reached = env.setup.task.place(env.setup, before, position, turned, near)
        return {f"placed_{name}": getattr(placed, name)[0] for name in goal} | {"reached": reached[None]}

    joints = shapes["q"]
    asked = {name: goal[name] for name in ("position", "quaternion") if name in goal} | {"near": joints}
    decided, (judge, begun) = trace("decide", decide, shapes, constants), _judge(functions, like, shapes)
    if env.pictured and not decided.reads(BODIES):  # it looks at them
        shapes = {name: shape for name, shape in shapes.items() if not name.startswith(BODIES)}
        decided = trace("decide", decide, shapes, constants)
        judge = None if judge.reads(BODIES) else _judge(functions, like, shapes)[0]
    return Behaviour(
        {name: list(shape.shape) for name, shape in shapes.items()},
        decided,
        trace("tool", tool, {"q": joints}),
        trace("place", place, asked) if "joints" in goal else None,
        judge,
        begun,
    )


def _judge(functions: EnvFunctions, like: EnvState, inputs: Shapes) -> tuple[Program, dict[str, list[float]]]:
    """The program `judge` of a controller with such inputs, and what it begins with, see `Behaviour`."""
    setup = functions.setup
    begin = setup.task.begin(setup, jax.tree.map(jnp.asarray, like.errors))
    leaves, form = jax.tree.flatten(begin)
    kept = {f"{KEPT}{number:02}": leaf[0] for number, leaf in enumerate(leaves) if leaf.size}
    idle = {name: jnp.zeros(inputs[name].shape) for name in ("command", "last_action")}
    seen = {name: shape for name, shape in inputs.items() if name in ("q", "qd") or name.startswith((GOAL, BODIES))}

    def judge(**given: Array) -> dict[str, Array]:
        state = measured_state(functions, like, idle | given)
        before = [given[f"{KEPT}{i:02}"][None] if leaf.size else leaf for i, leaf in enumerate(leaves)]
        now = functions.situation(state)._replace(contact=jnp.zeros(1, bool))  # which is not measured
        found = judged(setup, state.errors, jax.tree.unflatten(form, before), now, jnp.ones(1, jnp.int32))
        after = {f"{KEPT}{i:02}": leaf[0] for i, leaf in enumerate(jax.tree.leaves(found.progress)) if leaf.size}
        told = {"distance": found.errors.distance, "gap": found.gap, "near": found.near, "success": found.success}
        angle = {"angle": found.errors.angle} if found.errors.angle.size else {}
        return after | told | angle

    shapes = seen | {name: ShapeDtypeStruct(leaf.shape, leaf.dtype) for name, leaf in kept.items()}
    return trace("judge", judge, shapes), {name: np.asarray(leaf).ravel().tolist() for name, leaf in kept.items()}


def as_measured(functions: EnvFunctions) -> EnvFunctions:
    """Functions of an environment whose measurements are those that are given, and whose commands go on to a shell."""
    setup, rules = functions.setup, functions.setup.rules
    seen = replace(rules, goal_steps=None, goal_lost=0.0) if rules.hides_goal else rules
    return replace(functions, setup=replace(setup, rules=seen), randomise=(), limits=None)


def decision(functions: EnvFunctions, policy: Policy, state: EnvState, picture: Any) -> tuple[Any, ...]:
    """What is observed in states `[B]` and their pictures, the actions, the commands, and what is remembered then."""
    seen = functions.observe(state, picture)
    action, memory = policy.decide(seen, state.memory)
    action, command, _ = functions.command(state, action, None)
    return seen, action, command, memory


def remembered_as(name: str, memory: Memory) -> dict[str, Array]:
    """What is remembered `[1, M]` by a name; nothing of a policy without memory."""
    return {} if memory is None else {name: memory[0]}


def example_state(functions: EnvFunctions, begin: Begin | None = None) -> EnvState:
    """A state of one environment that shows what goals, bodies and progress are made of; nothing is computed.

    Where begins of episodes `[B, …]` are at hand, they need not be traced again.
    """
    setup = functions.setup
    if begin is None:
        like = jax.eval_shape(functions.sample_episode, jax.random.split(jax.random.key(0), 1))
    else:
        like: Begin = jax.tree.map(lambda one: ShapeDtypeStruct((1, *one.shape[1:]), one.dtype), begin)
    position, quaternion = (ShapeDtypeStruct((1, size), jnp.float32) for size in (3, 4))
    contact: Any = ShapeDtypeStruct((1, 0), jnp.bool_)
    opening: Any = ShapeDtypeStruct((1, len(setup.robot.actuators) - setup.robot.chain.n), jnp.float32)
    wrench: Any = ShapeDtypeStruct((1, WRENCH), jnp.float32) if setup.rules.wrench else None
    pose = cast("Pose", (position, quaternion))
    arm = SimState(like.q, like.q, *pose, like.bodies, contact, opening, wrench=wrench)
    shapes = jax.eval_shape(functions.begin, arm, like)
    return jax.tree.map(lambda one: np.zeros(one.shape, one.dtype), replace(shapes, key=like.q))


def _parts(record: Any) -> Shapes:
    """Names and shapes of what a record of arrays `[B, ...]` holds, for one of the batch; what is empty is left out."""
    shapes = {name: ShapeDtypeStruct(part.shape[1:], part.dtype) for name, part in vars(record).items()}
    return {name: shape for name, shape in shapes.items() if 0 not in shape.shape}


def decision_inputs(env: Env, like: EnvState) -> Shapes:
    """Names and shapes of what a decision is made of: what of goal and bodies there is in the task."""
    sizes: dict[str, int] = dict.fromkeys(("q", "qd", "command"), len(env.setup.robot.actuators))
    sizes |= {"last_action": len(env.action_bounds[0]), MEMORY: env.functions.memory}
    sizes |= {FELT: WRENCH} if env.setup.rules.wrench else {}
    shapes = {name: ShapeDtypeStruct((size,), jnp.float32) for name, size in sizes.items() if size}
    shapes |= {GOAL + name: shape for name, shape in _parts(like.goal).items() if name != "path"}
    shapes |= {BODIES + name: shape for name, shape in _parts(like.arm.bodies).items()}
    motion = motion_parts(like.motion)
    shapes |= {name: ShapeDtypeStruct(part.shape[1:], part.dtype) for name, part in motion.items()}
    return shapes | ({"picture": ShapeDtypeStruct((SIZE, SIZE), jnp.uint8)} if env.pictured else {})


def goal_of(like: EnvState, given: Mapping[str, Array]) -> Goal:
    """A goal `[1]` of what is given of it, and nothing else."""
    return _filled(like.goal, GOAL, given)


def bodies_of(like: EnvState, given: Mapping[str, Array]) -> Bodies:
    """Bodies `[1]` of what is given of them."""
    return _filled(like.arm.bodies, BODIES, given)


def _motion_of(like: EnvState, given: Mapping[str, Array]) -> Motion | None:
    """The motion `[1]` of the commands that is given, where they are shaped."""
    return None if like.motion is None else Motion(*(given[MOTION + name][None] for name in Motion._fields))


def motion_parts(motion: Motion | None) -> dict[str, Array]:
    """Parts of a motion `[B, m]` by name; none where commands are not shaped."""
    return {} if motion is None else {MOTION + name: part for name, part in motion._asdict().items()}


def _filled(like: Any, begin: str, given: Mapping[str, Array]) -> Any:
    nothing = {name: jnp.zeros(part.shape[1:], part.dtype) for name, part in vars(like).items()}
    return type(like)(**{name: given.get(begin + name, zero)[None] for name, zero in nothing.items()})


def measured_state(functions: EnvFunctions, like: EnvState, given: Mapping[str, Array]) -> EnvState:
    """State `[1]` of an arm that is measured."""
    setup, n = functions.setup, functions.setup.robot.chain.n
    q, qd, opening = given["q"][None, :n], given["qd"][None, :n], given["q"][None, n:]
    tool, contact = forward_kinematics(setup.robot.chain, q), jnp.zeros_like(like.arm.contact[:1])
    wrench = given[FELT][None] if FELT in given else None
    state = replace(
        like,
        arm=SimState(q, qd, *tool, bodies_of(like, given), contact, opening, wrench=wrench),
        goal=goal_of(like, given),
        command=given["command"][None],
        last_action=given["last_action"][None],
        clock=jnp.zeros(1, jnp.int32),
        motion=_motion_of(like, given),
        sensed=None,
        sight=None,
        memory=given[MEMORY][None] if MEMORY in given else None,
    )
    return replace(state, errors=setup.task.errors(setup, functions.situation(state)))


def rows_of(state: EnvState, picture: Any, names: Iterable[str]) -> Iterator[dict[str, Any]]:
    """Inputs of decisions by name, of each of a batch of states: lists of numbers, and a picture as it is."""
    speeds = jnp.concatenate([state.arm.qd, jnp.zeros_like(state.arm.opening)], axis=-1)
    known: dict[str, Any] = {"q": state.arm.actuated, "qd": speeds, MEMORY: state.memory, FELT: state.arm.wrench}
    known |= {"command": state.command, "last_action": state.last_action}
    known |= {GOAL + name: part for name, part in vars(state.goal).items()}
    known |= {BODIES + name: part for name, part in vars(state.arm.bodies).items()}
    given = {name: np.asarray(picture if name == "picture" else known[name]) for name in names}
    for row in range(len(state.command)):
        yield {name: part[row] if name == "picture" else part[row].ravel().tolist() for name, part in given.items()}
