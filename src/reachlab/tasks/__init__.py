"""Tasks: what is asked for, observed, commanded and rewarded, and when an episode ends."""

from __future__ import annotations

from reachlab.settings.tables import Lazy, Table

TASKS: dict[str, Lazy] = Table(
    {
        "tutorial": Lazy("touch a point on the table", "reachlab.tasks.tutorial:Tutorial"),
        "precise": Lazy("hold a point in the air, under full dynamics", "reachlab.tasks.precise:Precise"),
        "pose": Lazy("hold a position and an orientation, under full dynamics", "reachlab.tasks.pose:Pose"),
        "clutter": Lazy(
            "hold a point among obstacles without touching anything, under full dynamics",
            "reachlab.tasks.clutter:Clutter",
        ),
        "clutter_pose": Lazy(
            "hold a pose among obstacles without touching anything, under full dynamics",
            "reachlab.tasks.clutter_pose:ClutterPose",
        ),
        "track": Lazy("follow a point that moves, under full dynamics", "reachlab.tasks.track:Track"),
        "push": Lazy("push an object to a place on the table, under full dynamics", "reachlab.tasks.push:Push"),
        "lift": Lazy("grip an object and hold it in the air, under full dynamics", "reachlab.tasks.lift:Lift"),
        "slide": Lazy("strike a puck to a place out of reach, under full dynamics", "reachlab.tasks.slide:Slide"),
        "place": Lazy("set an object down behind a wall and let go, under full dynamics", "reachlab.tasks.place:Place"),
    }
)
"""Tasks by name, each the class of its settings. Adding one takes its file and its line here."""

WORDS = {
    "orientation": "a goal with an orientation, as of task pose",
    "joints": "a goal whose joints are known, as of task pose or clutter",
    "turning": "an action of the joints, as joint_delta",
    "velocity": "a goal that moves, as of task track",
    "bodies": "bodies beside the arm, as in task clutter",
    "contacts": "contacts, as in simulator mujoco",
    "object": "an object beside the arm, as in task push",
    "objects": "objects that move when they are touched, as in simulator mujoco",
    "gripper": "a gripper that opens and closes, as in task lift",
    "gripping": "an action of the gripper too, as joint_delta",
    "wrench": "a wrench that is measured, as in simulator mujoco, or in pybullet with an object",
    "dynamics": "arms that differ, as in simulator mujoco",
    "places": "an observation that says where things are, as state; from pictures an action acts alone, as joint_delta",
    "flat": "a goal on the table and one object, as in task push",
    "picture": "an observation with a picture, as image",
}
"""What observations, actions, agents, simulators and tasks may need or give, and how it is called."""
