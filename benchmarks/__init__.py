"""The measurements behind README and docs that take minutes to hours: `python -m benchmarks --help`."""

from __future__ import annotations

from reachlab.settings.tables import Lazy

SUITES: dict[str, Lazy] = {
    "simulators": Lazy(
        "The simulators against each other, against bare engines, and against the tutorial's way.",
        "benchmarks.simulators:simulators",
    ),
    "environments": Lazy(
        "Steps a second through Gymnasium's environments, beside the tutorial's own and the bare engine.",
        "benchmarks.environments:environments",
    ),
    "learners": Lazy(
        "Steps a second of Stable-Baselines3's PPO on a batch, and on its own vector of environments.",
        "benchmarks.learners:learners",
    ),
    "memory": Lazy(
        "Policies that remember beside those that observe one step or four, where arms and objects vary: a day.",
        "benchmarks.memory:memory",
    ),
    "critic": Lazy(
        "What a critic explains, and training without one, by the tutorial's first two observations: five minutes.",
        "benchmarks.critic:critic",
    ),
    "precise": Lazy(
        "Precision under full dynamics beside inverse kinematics, on nominal and on perturbed arms.",
        "benchmarks.precise:precise",
    ),
    "pose": Lazy(
        "Poses held under full dynamics beside inverse kinematics, on two arms: two hours.", "benchmarks.pose:pose"
    ),
    "track": Lazy(
        "Goals that move beside inverse kinematics that know their velocity, on two arms: an hour.",
        "benchmarks.track:track",
    ),
    "clutter": Lazy(
        "Points held among obstacles beside inverse kinematics and a sampling planner, on two arms: two hours.",
        "benchmarks.clutter:clutter",
    ),
    "ways": Lazy(
        "Scenes of furniture, without avoiding, with dampers and with the planner, on two arms: an hour.",
        "benchmarks.ways:ways",
    ),
    "onboard": Lazy(
        "Scenes of furniture, by the controller of an exported policy with its planner, on two arms: half an hour.",
        "benchmarks.onboard:onboard",
    ),
    "arms": Lazy("The tutorial's task on every robot of the catalogue, in three simulators.", "benchmarks.arms:arms"),
    "arms_precise": Lazy(
        "The precise task on every robot of the catalogue, beside inverse kinematics: two hours.",
        "benchmarks.arms:arms_precise",
    ),
    "handled": Lazy(
        "Objects that are pushed, lifted, placed and slid, by scripts and policies, and how well they are held.",
        "benchmarks.handled:handled",
    ),
    "deploy": Lazy(
        "What exports compute on every arm beside their policies, and how long a control step takes.",
        "benchmarks.deploy:deploy",
    ),
    "printed": Lazy(
        "Every pair of tasks, observations, actions and robots, exported to Python, C, JavaScript and a page.",
        "benchmarks.printed:printed",
    ),
    "programs": Lazy(
        "The programs that a first training of each kind compiles, and how long each takes.",
        "benchmarks.programs:programs",
    ),
    "waiting": Lazy(
        "Whole commands with nothing compiled and again, beside another version: AGAINST=FOLDER of its sources.",
        "benchmarks.waiting:waiting",
    ),
    "scale": Lazy(
        "Rollouts by Ray workers and trials of sweeps, and what more workers would come to.",
        "benchmarks.scale:scale",
    ),
    "soak": Lazy(
        "Bad actions, environments that take turns, and simulators made and closed many times.",
        "benchmarks.soak:soak",
    ),
    "camera": Lazy(
        "Policies that get camera pictures: speed, success in each simulator, and spoilt pictures.",
        "benchmarks.camera:camera",
    ),
    "pixels": Lazy("PPO from pixels: wall time and success.", "benchmarks.pixels:pixels"),
}
"""Suites by name: functions that yield rows, loaded when they are run. Adding one takes its file and its line here."""
