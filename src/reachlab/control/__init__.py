"""Classical control: what an engineer would do without learning, as pure functions, each with its tuned numbers."""

from __future__ import annotations

from reachlab.settings.tables import Lazy, Table

CONTROLLERS: dict[str, Lazy] = Table(
    {
        "resolved_rate": Lazy("to the goal's position by the Jacobian", "reachlab.control.resolved_rate:resolved_rate"),
        "feed_forward": Lazy(
            "the same to a goal that moves, its velocity fed forward", "reachlab.control.resolved_rate:feed_forward"
        ),
        "joint_servo": Lazy("every joint to where the goal has it", "reachlab.control.joint_servo:joint_servo"),
        "push": Lazy("an object along the table to the goal", "reachlab.control.pushing:push"),
        "push_seen": Lazy("the same of an object that a picture shows", "reachlab.control.pushing:push_seen"),
        "lift": Lazy("an object, gripped from above, to the goal", "reachlab.control.lifting:lift"),
        "slide": Lazy("a puck, struck, to the goal", "reachlab.control.sliding:slide"),
        "place": Lazy("the same over a wall, and let go", "reachlab.control.placing:place"),
    }
)
"""Controllers by name: functions of a `Drive` and a `Situation`.

They give a displacement of the joints `[B, n]`, or of joints and gripper `[B, m]`.
"""
