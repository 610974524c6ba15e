"""One client of PyBullet with full dynamics: an arm on motors, and objects that its finger tips move."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import NamedTuple

import mujoco
import numpy as np

from reachlab.control.bodies import Shape
from reachlab.render.observation_camera import CROSS
from reachlab.robots.kinematics.limits import own_servos
from reachlab.robots.robot import PybulletModel, Robot
from reachlab.sims.objects import ROLLING, TURNING
from reachlab.sims.pybullet_world import World
from reachlab.tasks.task import Scene

STEP = 0.002
"""Longest step of the engine [s]."""

ITERATIONS = 200
"""Of the engine's solver. With its usual 50 the forces of two fingers on what they grip do not balance: joints creep by
0.03 rad/s, and one of eight objects is not held still; with 200 they creep by 0.001 rad/s."""

EARTH = 9.81
"""Gravity, MuJoCo's [m/s²]. It pulls at the objects alone: that of the arm is compensated."""

STRONGEST = 1e6
"""Torque limit of a motor that has none [Nm or N]."""

COUPLING = 1000.0
"""Largest force of what couples the fingers [N]."""

FIXED, OBJECTS, TIPS, FIXED_TO_TIPS = 1, 2, 4, 8
"""Collision groups. Friction of a pair is the product of both: an object has that against what it lies on, which has 1,
and finger tips make it that of the grip; they meet a table and walls of their own, which have none."""

MEETS = {FIXED: OBJECTS, OBJECTS: FIXED | OBJECTS | TIPS, TIPS: OBJECTS | FIXED_TO_TIPS, FIXED_TO_TIPS: TIPS}
"""What each group can touch."""

PAINT, MARK = (0.85, 0.45, 0.2, 1.0), (0.1, 0.1, 0.1, 1.0)

DRAWN_TABLE = 0.006
"""So much higher than the table that is touched is the one that is drawn, PyBullet's, beside the tutorial's arm [m]."""


class Motors(NamedTuple):
    """Position motors `[m]` as PyBullet has them, with torque limits [Nm or N].

    After a step the speed is (1 - `damping`) × speed + `stiffness` × (command - position) / step.
    """

    stiffness: list[float]
    damping: list[float]
    torque: list[float]


def find_motors(model: mujoco.MjModel, home: np.ndarray, step: float) -> Motors:
    """Motors that follow commands as MuJoCo's servos do, which take damping at the end of a step, at home `[m]`.

    There they are the same to all digits, but that what a joint moves, with its armature, is taken as it is at home.
    """
    count, data, full = len(home), mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:count] = home
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    inertia, servos = full.diagonal()[:count], own_servos(model)
    numbers = [servos[joint] for joint in range(count)]
    damping = model.dof_damping[:count] - model.actuator_biasprm[numbers, 2]
    slowed = inertia + step * damping
    limited = model.actuator_forcelimited[numbers].astype(bool)
    torque = np.where(limited, model.actuator_forcerange[numbers, 1], STRONGEST)
    stiffness = step**2 * model.actuator_gainprm[numbers, 0] / slowed
    return Motors(stiffness.tolist(), (step * damping / slowed).tolist(), torque.tolist())


class ObjectWorld(World):
    """A world in which motors move the arm, and its finger tips the objects.

    What is in motion is a row of numbers: positions and speeds `[2 m]` of the joints, the gripper's after the arm's,
    then pose and velocity `[13]` of each object, as in `Bodies`.

    Attributes:
        touch: force [N] on the hand and its moment about the world's origin [Nm] `[6]`, mean of the last control
            period; nothing where the wrench is not measured.
    """

    def __init__(
        self,
        bullet: ModuleType,
        robot: Robot,
        urdf: PybulletModel,
        period: float,
        scene: Scene,
        motors: Motors,
        *,
        gui: bool,
    ) -> None:
        """World whose control period [s] is divided into steps of `STEP` at most."""
        super().__init__(bullet, robot, urdf, period, gui=gui)
        self._motors, self._all = motors, list(range(len(motors.torque)))
        self._walls: list[int] = []
        self._objects: list[int] = []
        self._cross: list[int] = []
        self._mass, self._friction = scene.mass, scene.friction
        # The engine tells the contacts of its last step alone, so where the wrench is measured each step is a call. It
        # tells no friction against turning: what hand and object do to each other follows from the object's motion.
        self._period, self._feels, self._calls = period, scene.wrench, substeps(period) if scene.wrench else 1
        self.touch = np.zeros(6)
        bullet = self.bullet
        kinds = {Shape.BALL: bullet.GEOM_SPHERE, Shape.CYLINDER: bullet.GEOM_CYLINDER, Shape.BOX: bullet.GEOM_BOX}
        self._kind = kinds[scene.shape]
        bullet.setPhysicsEngineParameter(numSubSteps=substeps(period) // self._calls, numSolverIterations=ITERATIONS)
        bullet.setTimeStep(period / self._calls)
        for body in self._furniture:
            bullet.setCollisionFilterGroupMask(body, -1, 0, 0)
        for link in range(bullet.getNumJoints(self._arm)):
            self._touches(self._arm, TIPS, link, lateralFriction=scene.grip / scene.friction, jointDamping=0.0)
        self._stand(bullet.createCollisionShape(bullet.GEOM_PLANE), -1, (0, 0, robot.table_top), (0, 0, 0, 1))
        if hand := robot.gripper:
            n, ways = robot.chain.n, np.subtract(hand.open, hand.closed)
            for finger in range(1, len(ways)):
                joined = self._arm, n, self._arm, n + finger, bullet.JOINT_GEAR, (0, 0, 1), (0, 0, 0), (0, 0, 0)
                gear = bullet.createConstraint(*joined)
                bullet.changeConstraint(gear, gearRatio=-ways[0] / ways[finger], maxForce=COUPLING, erp=0.2)

    def _touches(self, body: int, group: int, link: int = -1, **properties: float) -> None:
        """Put a link of a body into a group, with properties of its dynamics; the air does not slow it."""
        self.bullet.setCollisionFilterGroupMask(body, link, group, MEETS[group])
        self.bullet.changeDynamics(body, link, linearDamping=0.0, angularDamping=0.0, **properties)

    def _stand(self, solid: int, drawn: int, position: Sequence[float], turn: Sequence[float]) -> list[int]:
        """Two bodies in one place [m] that do not move: the one that objects meet, and the one that finger tips do."""
        bodies = []
        for group, friction in ((FIXED, 1.0), (FIXED_TO_TIPS, 0.0)):
            bodies.append(self.bullet.createMultiBody(0.0, solid, drawn, position, turn))
            self._touches(bodies[-1], group, lateralFriction=friction)
        return bodies

    def _shapes(self, kind: int, size: Sequence[float]) -> tuple[int, int]:
        """What is solid and what is drawn of a shape: a ball, a cylinder or a box with a size [m] as in `Bodies`."""
        numbers = kind, size[0], size, 2 * size[2]  # PyBullet takes of these what the shape has
        return self.bullet.createCollisionShape(*numbers), self.bullet.createVisualShape(*numbers, rgbaColor=PAINT)

    def become(self, walls: np.ndarray, sizes: np.ndarray, mass: float, share: float) -> None:
        """Have walls, boxes with poses and sizes `[f, 10]` m, and objects of `sizes [k, 3]` m, with a mass [kg].

        Their friction is a share of the scene's.

        All are made anew, also where they are what they were: with them the engine forgets what it knows of contacts,
        so that the same state is always followed by the same ones.
        """
        self._mass, bullet = mass, self.bullet
        for body in (*self._walls, *self._objects):
            bullet.removeBody(body)
        self._walls, self._objects = [], []
        for x, y, z, w, i, j, k, *half in walls.tolist():
            self._walls += self._stand(*self._shapes(bullet.GEOM_BOX, half), (x, y, z), (i, j, k, w))
        for size in sizes.tolist():
            body = bullet.createMultiBody(mass, *self._shapes(self._kind, size))
            self._objects.append(body)
            # Anchored where it sticks: without, an object turns between fingers by a degree in eight seconds.
            beside = {"spinningFriction": TURNING, "rollingFriction": ROLLING, "frictionAnchor": True}
            self._touches(body, OBJECTS, lateralFriction=share * self._friction, **beside)

    def put(self, row: np.ndarray) -> None:
        """Put joints and objects where a row has them, in motion as it says."""
        joints, bullet = 2 * len(self._all), self.bullet
        positions, speeds = row[:joints].reshape(2, -1, 1).tolist()
        bullet.resetJointStatesMultiDof(self._arm, self._all, positions, speeds)
        for body, numbers in zip(self._objects, row[joints:].reshape(-1, 13).tolist(), strict=True):
            w, *turn = numbers[3:7]
            turn = (*turn, w)
            bullet.resetBasePositionAndOrientation(body, numbers[:3], turn)
            bullet.resetBaseVelocity(body, numbers[7:10], bullet.rotateVector(turn, numbers[10:]))

    def mark(self, place: np.ndarray) -> None:
        """Draw a cross at a place `[3]` m; nothing touches it."""
        bullet = self.bullet
        if not self._cross:
            half = [size for _, size, *_ in CROSS]
            shapes = [bullet.createVisualShape(bullet.GEOM_BOX, halfExtents=one, rgbaColor=MARK) for one in half]
            self._cross = [bullet.createMultiBody(0.0, -1, shape) for shape in shapes]
        for body in self._cross:
            over = place + np.array([0.0, 0.0, DRAWN_TABLE * self._scale])
            bullet.resetBasePositionAndOrientation(body, over, (0, 0, 0, 1))

    def now(self) -> list[float]:
        """The row of what is in motion."""
        bullet, states = self.bullet, self.bullet.getJointStates(self._arm, self._all)
        row = [*(state[0] for state in states), *(state[1] for state in states)]
        for body in self._objects:
            place, (*turn, w) = bullet.getBasePositionAndOrientation(body)
            linear, angular = bullet.getBaseVelocity(body)
            back = (*(-number for number in turn), w)
            row += [*place, w, *turn, *linear, *bullet.rotateVector(back, angular)]
        return row

    def step(self, command: np.ndarray) -> None:
        """Move on by a control period, with all joints commanded to `[m]`."""
        bullet = self.bullet
        targets = command.tolist()
        keys = dict(zip(("positionGains", "velocityGains", "forces"), self._motors, strict=True))
        bullet.setJointMotorControlArray(self._arm, self._all, bullet.POSITION_CONTROL, targets, **keys)
        if self._feels:
            self.touch = self._felt_steps()
        else:
            self._pull()
            bullet.stepSimulation()

    def _pull(self) -> None:
        """Pull objects down by their weight, in what is stepped next."""
        for body in self._objects:
            place = self.bullet.getBasePositionAndOrientation(body)[0]
            self.bullet.applyExternalForce(body, -1, (0, 0, -EARTH * self._mass), place, self.bullet.WORLD_FRAME)

    def _felt_steps(self) -> np.ndarray:
        """Mean of what acts on the hand, see `touch`, over the steps of a control period, which are taken."""
        total, bullet = self._momentum() / self._period, self.bullet
        for _ in range(self._calls):
            places = [bullet.getBasePositionAndOrientation(body)[0] for body in self._objects]
            self._pull()
            bullet.stepSimulation()
            acting = [self._pushed(), *(_about_origin((0, 0, -EARTH * self._mass), place) for place in places)]
            total += np.sum(acting, axis=0) / self._calls
        return total - self._momentum() / self._period

    def _pushed(self) -> np.ndarray:
        """Force and moment `[6]` of table and walls on hand and objects, in the engine's last step."""
        total, held = np.zeros(6), {self._arm, *self._objects}
        for _, one, other, _, _, place, _, normal, _, most, *sliding in self.bullet.getContactPoints():
            if side := (one in held) - (other in held):
                along, across = (size * np.array(way) for size, way in (sliding[:2], sliding[2:]))
                total += side * _about_origin(most * np.array(normal) + along + across, place)
        return total

    def _momentum(self) -> np.ndarray:
        """Momentum [kg m/s] and angular momentum about the world's origin [kg m²/s] of the objects, `[6]`."""
        total, bullet = np.zeros(6), self.bullet
        for body in self._objects:
            (place, turn), (linear, angular) = bullet.getBasePositionAndOrientation(body), bullet.getBaseVelocity(body)
            axes = np.array(bullet.getMatrixFromQuaternion(turn)).reshape(3, 3)
            total += _about_origin(self._mass * np.array(linear), place)
            total[3:] += axes @ (bullet.getDynamicsInfo(body, -1)[2] * (angular @ axes))
        return total


def _about_origin(force: Sequence[float] | np.ndarray, place: Sequence[float]) -> np.ndarray:
    """A force at a place [m], or what is like one, and its moment about the world's origin, `[6]`."""
    return np.concatenate([force, np.cross(place, force)])


def substeps(period: float) -> int:
    """Steps of the engine in a control period [s]."""
    return int(np.ceil(period / STEP - 1e-9))
