"""What is measured on this machine, a file a suite: what the README and docs claim, by commands that stay."""

from __future__ import annotations

from reachlab.bench.table import Row
from reachlab.settings.tables import Lazy
from reachlab.settings.validation import choose

SUITES: dict[str, Lazy] = {
    "speed": Lazy("Environment and training steps a second.", "reachlab.bench.speed:speed"),
    "kinematics": Lazy(
        "Accuracy of forward kinematics, Jacobian and inverse kinematics.", "reachlab.bench.kinematics:kinematics"
    ),
    "learning": Lazy(
        "Success and wall time of whole trainings, in the default and in the author's setting.",
        "reachlab.bench.learning:learning",
    ),
    "start": Lazy(
        "Wall time of whole commands, with an empty and a warm compilation cache.", "reachlab.bench.start:start"
    ),
    "simulators": Lazy(
        "The simulators against each other, against bare engines, and against the tutorial's way.",
        "reachlab.bench.simulators:simulators",
    ),
    "environments": Lazy(
        "Steps a second through Gymnasium's environments, beside the tutorial's own and the bare engine.",
        "reachlab.bench.environments:environments",
    ),
    "learners": Lazy(
        "Steps a second of Stable-Baselines3's PPO on a batch, and on its own vector of environments.",
        "reachlab.bench.learners:learners",
    ),
    "precise": Lazy(
        "Precision under full dynamics beside inverse kinematics, on nominal and on perturbed arms.",
        "reachlab.bench.precise:precise",
    ),
    "pose": Lazy(
        "Poses held under full dynamics beside inverse kinematics, on two arms: two hours.", "reachlab.bench.pose:pose"
    ),
    "track": Lazy(
        "Goals that move beside inverse kinematics that know their velocity, on two arms: an hour.",
        "reachlab.bench.track:track",
    ),
    "clutter": Lazy(
        "Points held among obstacles beside inverse kinematics and a sampling planner, on two arms: two hours.",
        "reachlab.bench.clutter:clutter",
    ),
    "arms": Lazy(
        "The tutorial's task on every robot of the catalogue, in three simulators.", "reachlab.bench.arms:arms"
    ),
    "arms_precise": Lazy(
        "The precise task on every robot of the catalogue, beside inverse kinematics: two hours.",
        "reachlab.bench.arms:arms_precise",
    ),
    "deploy": Lazy(
        "What exports compute on every arm beside their policies, and how long a control step takes.",
        "reachlab.bench.deploy:deploy",
    ),
    "scale": Lazy(
        "Rollouts by Ray workers and trials of sweeps, and what more workers would come to.",
        "reachlab.bench.scale:scale",
    ),
    "soak": Lazy(
        "Bad actions, environments that take turns, and simulators made and closed many times.",
        "reachlab.bench.soak:soak",
    ),
    "camera": Lazy(
        "Policies that get camera pictures: speed, success in each simulator, and spoilt pictures.",
        "reachlab.bench.camera:camera",
    ),
    "pixels": Lazy("PPO from pixels: wall time and success.", "reachlab.bench.pixels:pixels"),
}
"""Suites by name: functions that yield rows, loaded when they are run. Adding one takes its file and its line here."""


def run_suite(name: str) -> list[Row]:
    """Rows of a suite.

    Raises:
        InputError: there is no such suite.
    """
    return list(SUITES[choose("suite", name, SUITES)].load()())
