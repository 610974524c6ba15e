"""Commands that are shaped: within limits of position, speed, acceleration and jerk, and always able to stop."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.control.bodies import absent
from reachlab.control.motion_limits import STOP_TIME, Motion, MotionLimits
from reachlab.envs.core import Env
from reachlab.envs.delays import JITTER, LATEST, LOST, UNSEEN, Sensed, Sight, sense
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import TRAINING_STREAM, episode_keys
from reachlab.evaluation.report import evaluate
from reachlab.robots.loading import load_robot
from reachlab.sims.simulator import SimState

ARMS = ("iiwa14", "panda", "gen3", "so101")
PERIODS = (0.02, 1 / 240, 0.008)


def limits_of(robot: str, period: float) -> MotionLimits:
    arm = load_robot(robot)
    return MotionLimits(arm.chain.lower, arm.chain.upper, arm.speed, arm.acceleration, arm.jerk, period)


def past(limits: MotionLimits, positions: np.ndarray) -> list[float]:
    """By how much positions `[k, n]` leave their limits, and how much of those of their differences they use."""
    kinds = enumerate((limits.speed, limits.acceleration, limits.jerk), start=1)
    shares = [float(np.abs(np.diff(positions, n, axis=0) / limits.period**n / limit).max()) for n, limit in kinds]
    return [float((limits.lower - positions).max()), float((positions - limits.upper).max()), *shares]


def hostile(limits: MotionLimits, random: np.random.Generator, step: int, motion: Motion) -> np.ndarray:
    """What may be asked for: anywhere, far outside, here and there, full speed ahead, and into a limit."""
    lower, upper = limits.lower, limits.upper
    kind = step // 100 % 5
    if kind == 0:
        return random.uniform(lower - 1, upper + 1)
    if kind == 1:
        return random.choice([-1e6, 1e6], limits.n)
    if kind == 2:
        return motion.position + random.normal(size=limits.n) * limits.speed * limits.period
    if kind == 3:
        return motion.position + limits.speed * limits.period
    return upper + 1.0 if step // 500 % 2 else lower - 1.0


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("robot", ARMS)
def test_no_command_leaves_a_limit_whatever_is_asked_for(robot: str, period: float) -> None:
    limits, random = limits_of(robot, period), np.random.default_rng(0)
    motion = limits.at_rest(np.array(load_robot(robot).home, float))
    positions = [motion.position] * 4
    for step in range(4000):
        motion = limits.advance(motion, hostile(limits, random, step, motion), brake=random.random() < 0.05)
        positions.append(motion.position)
    below, above, *shares = past(limits, np.array(positions))
    assert below <= 0
    assert above <= 0
    assert max(shares) <= 1 + 1e-6
    assert max(shares) > 0.99, "the limits are used"


@pytest.mark.parametrize("robot", ARMS)
def test_it_can_stop_in_time_at_any_moment(robot: str) -> None:
    limits, random = limits_of(robot, 0.02), np.random.default_rng(1)
    motion = limits.at_rest(np.array(load_robot(robot).home, float))
    for step in range(600):
        motion = limits.advance(motion, hostile(limits, random, step, motion))
        stopping = motion
        for _ in range(round(STOP_TIME / limits.period)):
            stopping = limits.advance(stopping, stopping.position, brake=True)
        assert np.abs(stopping.speed).max() < 1e-12
        assert np.abs(stopping.acceleration).max() < 1e-12


def test_an_arm_that_may_go_fast_comes_to_its_full_speed() -> None:
    limits = limits_of("iiwa14", 0.02)
    motion = limits.at_rest(np.zeros(limits.n))
    for _ in range(20):
        motion = limits.advance(motion, motion.position + limits.speed * limits.period)
    assert motion.speed == pytest.approx(limits.speed, rel=0.02)


def test_a_gentle_wish_is_followed_at_once() -> None:
    limits = limits_of("panda", 0.02)
    motion = limits.at_rest(np.array(load_robot("panda").home, float))
    for step in range(50):
        wanted = motion.position + 0.001 * np.sin(0.1 * step)
        motion = limits.advance(motion, wanted)
        assert motion.position == pytest.approx(wanted, abs=1e-12)


def test_environments_shape_a_batch_as_the_controller_shapes_one_arm() -> None:
    limits, random = limits_of("ur5e", 0.02), np.random.default_rng(2)
    alone = limits.at_rest(np.array(load_robot("ur5e").home, float))
    advance = jax.jit(lambda motion, wanted: limits.advance(motion, wanted, xp=jnp))
    for step in range(200):
        wanted = alone.position + random.uniform(-1, 1, limits.n) * limits.speed * limits.period * (step % 40 > 5)
        # Each from the same motion: single precision adds up.
        batch = advance(jax.tree.map(lambda part: jnp.tile(part, (3, 1)), alone), jnp.tile(wanted, (3, 1)))
        alone = limits.advance(alone, wanted)
        assert np.asarray(batch.position) == pytest.approx(np.tile(alone.position, (3, 1)), abs=1e-5)
    assert np.abs(alone.position - np.array(load_robot("ur5e").home)).max() > 0.1


def test_an_environment_keeps_the_limits_in_training() -> None:
    env = Env(configure("precise", shaping=True, randomise=()), 16)
    state = env.init(episode_keys(0, TRAINING_STREAM, 0, 16))
    random, commands = np.random.default_rng(0), [np.asarray(state.command)] * 4
    for _ in range(100):
        state, _ = env.step(state, random.uniform(-1, 1, (16, 7)).astype(np.float32))
        commands.append(np.asarray(state.command))
    robot = env.setup.robot
    for order, limit in ((1, robot.speed), (2, robot.acceleration)):
        rates = np.diff(np.array(commands, float), order, axis=0) / env.setup.period**order
        assert (np.abs(rates).max(axis=(0, 1)) <= np.array(limit) * 1.02).all(), "but for single precision"
    env.close()


FOLLOWED = (("precise", "kinematic"), ("pose", "kinematic"), ("track", "kinematic"), ("track", "mujoco"))
"""Tasks and simulators in which controllers would swing about their goals if they knew nothing of the limits."""


@pytest.mark.parametrize(("task", "sim"), FOLLOWED)
def test_controllers_arrive_within_limits_that_nobody_stated(task: str, sim: str) -> None:
    env = Env(configure(task, robot="ur5e", sim=sim, shaping=True, randomise=("delay",)), 16)
    assert evaluate(env, "ik", None, episodes=16).success_rate > 0.9
    env.close()


# --- measurements that come late ------------------------------------------------------------------


def test_measurements_are_a_period_old_and_some_do_not_come() -> None:
    count, period = 4000, 0.02
    keys = episode_keys(0, TRAINING_STREAM, 0, count)
    now, past_q, known = (jnp.full((count, 2), value) for value in (3.0, 1.0, -5.0))
    arm = SimState(
        now, now, jnp.zeros((count, 3)), jnp.zeros((count, 4)), absent(count, 0), jnp.zeros(count, bool), now[:, :0]
    )
    told = sense(Sensed(known, known, past_q, past_q), arm, keys, jnp.ones(count, jnp.int32), period)
    q = np.asarray(told.q)
    lost = q[:, 0] == -5.0
    assert lost.mean() == pytest.approx(LOST, abs=0.012)
    oldest = 3.0 - 2.0 * JITTER / period
    assert oldest <= q[~lost].min() < oldest + 0.05
    assert 2.95 < q[~lost].max() <= 3.0
    assert np.asarray(told.past_q) == pytest.approx(3.0)


def test_bodies_are_seen_late_in_their_order_and_some_sights_do_not_come() -> None:
    count = 4000
    keys, ages = episode_keys(0, TRAINING_STREAM, 0, count), []
    bodies = absent(count, 1)
    sight = Sight.of(bodies)
    for step in range(1, 12):
        now = replace(bodies, position=jnp.full((count, 1, 3), float(step)))
        sight = sight.after(now, keys, jnp.full(count, step))
        ages.append(step - np.asarray(sight.known.position)[:, 0, 0])
    # What is known never goes back in time.
    assert (np.diff(ages[3:], axis=0) <= 1).all()
    late, share = ages[-1], UNSEEN
    assert late.min() == 1
    assert (late == 1).mean() == pytest.approx((1 - share) / LATEST, abs=0.03)
    older = share * (share + (1 - share) / LATEST) * (share + (1 - share) * (1 - 1 / LATEST))
    assert (late > LATEST).mean() == pytest.approx(older, abs=0.008)


def test_a_policy_sees_where_the_arm_was_and_rewards_where_it_is() -> None:
    env = Env(configure("precise", randomise=("delay",)), 8)
    state = env.init(episode_keys(0, TRAINING_STREAM, 0, 8))
    action = np.ones((8, 7), np.float32)
    state, _ = env.step(*env.step(state, action)[:1], action)
    before = np.asarray(state.arm.q)
    state, transition = env.step(state, action)
    seen = np.asarray(env.situation(state).q)
    assert (np.abs(seen - np.asarray(state.arm.q)).max(axis=1) > 1e-4).all(), "nobody knows where it is now"
    assert np.asarray(transition.observation)[:, :7] == pytest.approx(seen, abs=1e-6)
    assert np.abs(seen - before).max() < np.abs(np.asarray(state.arm.q) - before).max() + 0.05
    env.close()
