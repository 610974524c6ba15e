"""Robot files of public packages, as their makers wrote them: what `make foreign` and the tests read, and train on."""

from __future__ import annotations

import math
import re
import sysconfig
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from benchmarks.arms import precise, tutorial
from reachlab.jax_setup import jit, use_compilation_cache
from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.robots.loading import load_robot

DESCRIPTIONS = Path(sysconfig.get_path("purelib"), "cmeel.prefix/share/example-robot-data/robots")
"""Where the package `example-robot-data` puts its files."""

BULLET = Path(sysconfig.get_path("purelib"), "pybullet_data")

FILES: dict[str, Path] = {
    "panda (pybullet_data)": BULLET / "franka_panda/panda.urdf",
    "xarm6": BULLET / "xarm/xarm6_robot.urdf",
    "panda": DESCRIPTIONS / "panda_description/urdf/panda.urdf",
    "ur3": DESCRIPTIONS / "ur_description/urdf/ur3_robot.urdf",
    "ur5": DESCRIPTIONS / "ur_description/urdf/ur5_robot.urdf",
    "ur10": DESCRIPTIONS / "ur_description/urdf/ur10_robot.urdf",
    "xarm7": DESCRIPTIONS / "xarm_description/urdf/xarm7.urdf",
    "so100": DESCRIPTIONS / "so_arm_description/urdf/so100.urdf",
    "so101": DESCRIPTIONS / "so_arm_description/urdf/so101.urdf",
    "kinova": DESCRIPTIONS / "kinova_description/robots/kinova.urdf",
    "z1": DESCRIPTIONS / "z1_description/urdf/z1.urdf",
}
"""Files by the name of their arm."""


def bare(file: Path) -> ElementTree.Element:
    """A description without its shapes, which are named by packages that PyBullet does not find."""
    root = ElementTree.fromstring(file.read_text(encoding="utf-8"))
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    return root


def largest_difference(file: Path, chain: Chain, joints: tuple[str, ...], tool: str, poses: int) -> float:
    """Largest distance of our tool from where PyBullet, which reads the same file, has it [m]."""
    q = np.random.default_rng(0).uniform(chain.lower, chain.upper, (poses, chain.n)).astype(np.float32)
    ours = np.asarray(jit(lambda q: forward_kinematics(chain, q).position)(q))
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

    bullet = BulletClient(pybullet.DIRECT)
    try:
        with tempfile.TemporaryDirectory() as folder:
            written = Path(folder) / "bare.urdf"
            # PyBullet breaks lines at about a thousand characters.
            written.write_text(re.sub(r"><", ">\n<", ElementTree.tostring(bare(file), encoding="unicode")))
            arm = bullet.loadURDF(str(written), useFixedBase=True)
        infos = [bullet.getJointInfo(arm, i) for i in range(bullet.getNumJoints(arm))]
        numbers = {info[1].decode(): info[0] for info in infos}
        link = next(info[0] for info in infos if info[12].decode() == tool)
        order, worst = [numbers[joint] for joint in joints], 0.0
        for one, point in zip(q, ours, strict=True):
            bullet.resetJointStatesMultiDof(arm, order, [[value] for value in one.tolist()])
            theirs = bullet.getLinkState(arm, link, computeForwardKinematics=True)[4]
            worst = max(worst, math.dist(theirs, point))
        return worst
    finally:
        bullet.disconnect()


def measured() -> Iterator[str]:
    """What becomes of each file, in lines."""
    with tempfile.TemporaryDirectory() as folder:
        for name, file in FILES.items():
            start = time.perf_counter()
            robot = load_robot(str(file))
            yield f"{name}: ready in {time.perf_counter() - start:.1f} s"
            difference = largest_difference(file, robot.chain, robot.joint_names, robot.tool, 10_000)
            yield f"{name}: kinematics within {difference:.1e} m of PyBullet's"
            for rows in (tutorial(str(file), Path(folder) / name, [0]), precise(str(file), Path(folder) / name, [0])):
                for row in rows:
                    yield f"{name}: {row['name']} {row['value']:.6g} {row['unit']}"


if __name__ == "__main__":
    use_compilation_cache()
    for line in measured():
        print(line, flush=True)  # noqa: T201
