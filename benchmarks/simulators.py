"""Suite `simulators`: the simulators against each other, against bare engines, and against the tutorial's way."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import Space
from mujoco.batch import Batch

from reachlab.bench.table import Row, row
from reachlab.control.bodies import absent
from reachlab.control.situation import Goal
from reachlab.envs.core import Env
from reachlab.envs.presets import configure, in_simulator
from reachlab.envs.random_streams import env_keys
from reachlab.evaluation.episodes import BATCH
from reachlab.evaluation.report import FRESH_SEED, evaluate
from reachlab.jax_setup import jit
from reachlab.learn.train import train
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.robots.kinematics.limits import own_servos
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import PybulletModel, Robot
from reachlab.sims.mujoco_model import physics_model
from reachlab.sims.pybullet_world import GRAVITY, GROUND, TABLE, import_pybullet
from reachlab.sims.simulator import Begin, make_simulator

ENVIRONMENT = "reachlab:reachlab/Reach-v0"

ACTIONS = 64
"""Random actions for each environment, taken in turns; they are sampled beforehand."""

TRANSFER_SEEDS, TRANSFER_EPISODES = range(3), 1000
"""Policies, and held-out episodes for each."""

NUM_ENVS = {"kinematic": BATCH, "mujoco": BATCH, "pybullet": 8}
"""Environments of an evaluation in each simulator."""

POSES = 10_000
PARITY_EPISODES, PARITY_STEPS = 100, 100
"""Random joint vectors, and random episodes, of the comparisons with PyBullet."""

EPISODE_STEPS, AUTHOR_EPISODES, OUR_EPISODES = 100, 10, 30
"""Length and number of the timed PyBullet episodes."""

MUJOCO_BATCHES, MUJOCO_STEPS, MUJOCO_ROUNDS = (256, 512, 1024), 30, 6
"""Batch sizes of the MuJoCo measurement, control steps of a round, and rounds."""


TOOL_SCALE = 0.005
"""Displacement of the tool for an action of 1: the tutorial's [m]."""


def _begin(q: Any, goal: Goal) -> Begin:
    """An episode of one arm at joints `[1, n]`, with nothing beside it."""
    return Begin(jnp.zeros(1), q, goal, absent(1, 0), jnp.zeros((1, 0)))


def simulators() -> Iterator[Row]:
    """The rows of suite `simulators`."""
    yield from transfer()
    yield from pybullet_kinematics()
    yield from pybullet_parity()
    yield from pybullet_speed()
    yield from mujoco_speed()


def transfer() -> Iterator[Row]:
    """Success in every simulator of policies trained in the kinematic one."""
    with tempfile.TemporaryDirectory() as folder:
        for seed in TRANSFER_SEEDS:
            config = configure(seed=seed)
            trained = train(config, Path(folder) / str(seed))
            for name, num_envs in NUM_ENVS.items():
                env = Env(in_simulator(config, name), num_envs)
                report = evaluate(env, "trained", trained.policy, seed=FRESH_SEED + seed, episodes=TRANSFER_EPISODES)
                env.close()
                yield row(f"transfer/{name}", report.success_rate, "rate", seed=seed, episodes=TRANSFER_EPISODES)


def pybullet_kinematics() -> Iterator[Row]:
    """Largest difference between the tool positions of our chain and of PyBullet's own URDF."""
    robot = load_robot("iiwa14")
    chain, bullet = robot.chain, make_simulator("pybullet", robot, configure().physics, 1)
    q = np.random.default_rng(1).uniform(chain.lower, chain.upper, (POSES, chain.n)).astype(np.float32)
    ours = np.asarray(jit(lambda q: forward_kinematics(chain, q).position)(q))
    goal = Goal.at(jnp.zeros((1, 3)))
    theirs = np.array([bullet.reset(None, _begin(joints[None], goal), None).tool_position[0] for joints in q])
    bullet.close()
    yield row("forward_kinematics_error/pybullet", np.linalg.norm(ours - theirs, axis=1).max(), "m", poses=POSES)


def pybullet_parity() -> Iterator[Row]:
    """Largest difference of the kinematic simulator and PyBullet under equal commands; the error of PyBullet's IK."""
    env = Env(configure(), PARITY_EPISODES)
    low, high = env.action_bounds
    actions = np.random.default_rng(2).uniform(low, high, (PARITY_STEPS, PARITY_EPISODES, len(low)))
    step = env.compile_whole(lambda state, action: env.step(state, action)[0])
    states = [env.compile_whole(env.init)(env_keys(0, PARITY_EPISODES))]
    for action in actions.astype(np.float32):
        states.append(step(states[-1], action))
    commands = np.array([state.arm.q for state in states])
    points = np.array([state.arm.tool_position for state in states])

    bullet = make_simulator("pybullet", env.setup.robot, env.config.physics, 1)
    apart = 0.0
    for index in range(PARITY_EPISODES):
        goal = Goal.at(states[0].goal.position[index : index + 1])
        arm = bullet.reset(None, _begin(commands[0, index : index + 1], goal), None)
        for command, point in zip(commands[1:, index], points[1:, index], strict=True):
            arm = bullet.step(arm, command[None])
            assert arm.tool is not None  # noqa: S101
            apart = max(apart, float(np.linalg.norm(np.asarray(arm.tool.position)[0] - point)))
    bullet.close()
    yield row("parity/pybullet", apart, "m", episodes=PARITY_EPISODES, steps=PARITY_STEPS)

    author, stray = Author(env.setup.robot), []
    for before, after, action in zip(points[:-1, 0], points[1:, 0], actions[:, 0], strict=True):
        author.set_joints(author.solve(before + env.setup.rules.tool_scale * action))
        stray.append(np.linalg.norm(author.tool() - after))
    author.close()
    yield row("pybullet_ik_stray", float(np.median(stray)), "m, median", max=float(np.max(stray)), steps=PARITY_STEPS)


MODEL = cast("PybulletModel", ROBOTS["iiwa14"].pybullet)
"""The arm in PyBullet's data."""


class Author:
    """The tutorial's way: one client, its world rebuilt from files at every reset, PyBullet's own IK."""

    def __init__(self, robot: Robot) -> None:
        """World with the arm at home."""
        self._robot, self._bullet = robot, import_pybullet()
        self._client = self._bullet.connect(self._bullet.DIRECT)
        self.rebuild()

    def rebuild(self) -> None:
        """Load everything again."""
        import pybullet_data

        bullet, client = self._bullet, self._client
        bullet.resetSimulation(physicsClientId=client)
        bullet.setGravity(0, 0, GRAVITY, physicsClientId=client)
        bullet.setAdditionalSearchPath(pybullet_data.getDataPath(), physicsClientId=client)
        bullet.loadURDF("plane.urdf", basePosition=GROUND, physicsClientId=client)
        bullet.loadURDF("table/table.urdf", basePosition=TABLE, physicsClientId=client)
        self._arm = bullet.loadURDF(MODEL.file, useFixedBase=True, physicsClientId=client)
        bullet.loadURDF("random_urdfs/000/000.urdf", basePosition=(0.5, 0, 0.01), physicsClientId=client)
        self.set_joints(self._robot.home)

    def solve(self, position: np.ndarray) -> tuple[float, ...]:
        """Joints of PyBullet's IK for a tool position, damped by 1e-5 a joint."""
        w, x, y, z = self._robot.held_quaternion
        damping = [1e-5] * self._robot.chain.n
        return self._bullet.calculateInverseKinematics(
            self._arm, MODEL.link, position, (x, y, z, w), jointDamping=damping, physicsClientId=self._client
        )

    def set_joints(self, q: Sequence[float]) -> None:
        """Set the joints one by one."""
        for joint, value in enumerate(q):
            self._bullet.resetJointState(self._arm, joint, value, physicsClientId=self._client)

    def tool(self) -> np.ndarray:
        """Tool position `[3]` m."""
        state = self._bullet.getLinkState(
            self._arm, MODEL.link, computeForwardKinematics=True, physicsClientId=self._client
        )
        return np.array(state[4])

    def step(self, action: np.ndarray) -> None:
        """One step of the tutorial's environment."""
        self.set_joints(self.solve(self.tool() + TOOL_SCALE * action))
        self._bullet.stepSimulation(physicsClientId=self._client)
        self.tool()

    def close(self) -> None:
        """Disconnect."""
        self._bullet.disconnect(physicsClientId=self._client)


def pybullet_speed() -> Iterator[Row]:
    """Environment steps a second in PyBullet beside the tutorial's way: a Gymnasium environment, and a batch of 16."""
    author = _author_steps_per_second()
    yield row("env_steps_per_second/pybullet-author", author, "1/s", episode_steps=EPISODE_STEPS)
    config, steps = configure(sim="pybullet", max_steps=EPISODE_STEPS), EPISODE_STEPS * OUR_EPISODES
    env = Env(config, 16)
    single = single_steps(steps, sim="pybullet", max_steps=EPISODE_STEPS)
    rates = {1: single(), 16: _host_steps_per_second(env, steps // 5)}
    env.close()
    for num_envs, rate in rates.items():
        yield row("env_steps_per_second/pybullet", rate, "1/s", num_envs=num_envs, ratio=round(rate / author, 2))


def single_steps(steps: int, **settings: Any) -> Callable[[], float]:
    """Measures the steps a second of one Gymnasium environment, over so many of them, resets included."""
    env = gymnasium.make(ENVIRONMENT, **settings)
    actions = sampled_actions(env.action_space)
    env.reset(seed=0)

    def measure() -> float:
        start = time.perf_counter()
        for number in range(steps):
            _, _, terminated, truncated, _ = env.step(actions[number % ACTIONS])
            if terminated or truncated:
                env.reset()
        return steps / (time.perf_counter() - start)

    measure()
    return measure


def sampled_actions(space: Space[Any]) -> list[Any]:
    """Random actions, the same at every call."""
    space.seed(0)
    return [space.sample() for _ in range(ACTIONS)]


def _author_steps_per_second() -> float:
    author, random = Author(load_robot("iiwa14")), np.random.default_rng(0)
    start = time.perf_counter()
    for _ in range(AUTHOR_EPISODES):
        author.rebuild()
        for action in random.uniform(-0.4, 0.3, (EPISODE_STEPS, 3)):
            author.step(action)
    seconds = time.perf_counter() - start
    author.close()
    return AUTHOR_EPISODES * EPISODE_STEPS / seconds


def _random_actions(env: Env, steps: int) -> np.ndarray:
    low, high = env.action_bounds
    return np.random.default_rng(0).uniform(low, high, (steps, env.num_envs, len(low))).astype(np.float32)


def _host_steps_per_second(env: Env, steps: int) -> float:
    state, actions = env.init(env_keys(0, env.num_envs)), _random_actions(env, steps)
    warm, timed = actions[:2], actions[2:]
    for action in warm:
        state = env.reset(env.step(state, action)[0], np.ones(env.num_envs, bool))
    start = time.perf_counter()
    for action in timed:
        state, transition = env.step(state, action)
        done = np.asarray(transition.done)
        if done.any():
            state = env.reset(state, done)
    jax.block_until_ready(state.distance)
    return len(timed) * env.num_envs / (time.perf_counter() - start)


def mujoco_speed() -> Iterator[Row]:
    """Control steps a second through the environment, and their share of `bare_engine`'s, best of the batches.

    Both are timed in turns, since other work on the machine comes and goes; the best of each counts.
    """
    results = []
    for num_envs in MUJOCO_BATCHES:
        env = Env(configure(sim="mujoco"), num_envs)
        bare = bare_engine(env, _random_actions(env, MUJOCO_STEPS))
        rates = [(_host_steps_per_second(env, MUJOCO_STEPS), bare()) for _ in range(MUJOCO_ROUNDS)]
        env.close()
        through, engine = (max(column) for column in zip(*rates, strict=True))
        results.append((through, num_envs, through / engine))
    rate, num_envs, share = max(results)
    yield row("env_steps_per_second/mujoco", rate, "1/s", num_envs=num_envs, share_of_bare=round(share, 3))


def bare_engine(env: Env, actions: Sequence[np.ndarray] | np.ndarray) -> Callable[[], float]:
    """Measures the steps a second of the engine alone, moving the arms of an environment as it would itself.

    Arms and objects start where its first episodes do, and are given the commands that actions `[B, a]`, one a step,
    led to in the environment: an arm that moves takes the engine an eighth longer than one that is held still.
    """
    robot, state = env.setup.robot, env.init(env_keys(0, env.num_envs))
    model = physics_model(robot, env.config.physics, env.setup.task.scene(env.setup))
    servos, batch = own_servos(model), Batch(model, nsim=env.num_envs)
    first = np.asarray(state.arm.engine).view(np.float64)[:, : batch.state.shape[1]]
    ctrl, commands = batch.bind("ctrl"), []
    for action in actions:
        state, _ = env.step(state, action)
        commands.append(np.array([robot.posture(row) for row in np.asarray(state.command)]))
    columns = [servos[joint] for joint in range(commands[0].shape[1])]

    def measure() -> float:
        batch.state[:] = first
        start = time.perf_counter()
        for command in commands:
            ctrl[:, columns] = command
            batch.step(nstep=env.config.physics.physics_steps)
        return len(commands) * env.num_envs / (time.perf_counter() - start)

    return measure
