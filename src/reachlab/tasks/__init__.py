"""What is asked of an arm: goals, observations, actions, rewards, and when an episode ends."""

from __future__ import annotations

from reachlab.settings.tables import Lazy

TASKS: dict[str, Lazy] = {
    "tutorial": Lazy("touch a point on the table", "reachlab.tasks.reach:TUTORIAL"),
    "precise": Lazy("hold a point in the air, under full dynamics", "reachlab.tasks.reach:PRECISE"),
    "pose": Lazy("hold a position and an orientation, under full dynamics", "reachlab.tasks.reach:POSE"),
    "clutter": Lazy(
        "hold a point among obstacles without touching anything, under full dynamics", "reachlab.tasks.clutter:CLUTTER"
    ),
    "track": Lazy("follow a point that moves, under full dynamics", "reachlab.tasks.track:TRACK"),
}
"""Tasks by name, each a `Task`. Adding one takes its file, its line here, and a rule in `settings.presets`."""
