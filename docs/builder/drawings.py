"""Drawings of how it works, `images/way.svg` and `images/rooms.svg`: `python docs/builder/drawings.py` draws them anew.

Boxes bring their own ground, so that they can be read on a light page and on a dark one; 360 units are the width of a
phone.
"""

from __future__ import annotations

from pathlib import Path

IMAGES = Path(__file__).parents[1] / "images"

WIDTH = 360

INK, ARROW = "#14233a", "#7d8ba0"

BLUE, GREEN, ORANGE, GREY = "#cfe0f7", "#cdebd5", "#fbe0c3", "#e3e6eb"

ROOMS = (
    ("settings", "what can be set", GREY),
    ("robots", "what an arm is", BLUE),
    ("control", "without learning", BLUE),
    ("tasks", "what is asked of it", BLUE),
    ("render", "how it is drawn", BLUE),
    ("sims", "what moves it", BLUE),
    ("envs", "episodes", BLUE),
    ("agents", "what acts", GREEN),
    ("runs", "what is kept", GREEN),
    ("evaluation", "how good it is", GREEN),
    ("learn", "how it is learnt", GREEN),
    ("emit", "behaviour printed", GREEN),
    ("watch", "what people look at", ORANGE),
    ("deploy", "out to a robot", ORANGE),
    ("scale", "more than one process", ORANGE),
    ("bench", "what is measured", ORANGE),
    ("cli", "the command line", ORANGE),
)
"""Folders of the package from the ground up, in a few words each."""


def box(x: float, y: float, width: float, height: float, title: str, text: str, colour: str) -> str:
    """A box with a title and a line of text below it."""
    middle, below = x + width / 2, 15 if text else 0
    lines = f'<text x="{middle:g}" y="{y + height / 2 + 5 - below / 2:g}" class="title">{title}</text>'
    if text:
        lines += f'<text x="{middle:g}" y="{y + height / 2 + 12:g}">{text}</text>'
    shape = f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="7" fill="{colour}"/>'
    return shape + lines + "\n"


def arrow(*points: tuple[float, float]) -> str:
    """A line along points, with a head at the last one."""
    path = " ".join(f"{x:g},{y:g}" for x, y in points)
    return f'<polyline points="{path}" marker-end="url(#head)"/>\n'


def drawing(height: float, label: str, body: str) -> str:
    """A picture of that height."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:g}" role="img" aria-label="{label}"'
        f' width="{WIDTH * 1.3:g}">\n'
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        f'<path d="M0,0 L8,4 L0,8 z" fill="{ARROW}"/></marker></defs>\n'
        f"<style>text {{ font: 12px sans-serif; fill: {INK}; text-anchor: middle }}"
        f" .title {{ font: bold 14px sans-serif }}"
        f" .left {{ text-anchor: start }} polyline {{ fill: none; stroke: {ARROW}; stroke-width: 2 }}</style>\n"
        f"{body}</svg>\n"
    )


def way() -> str:
    """The way of the data, from the robot file to what people get."""
    body = box(90, 6, 180, 48, "Robot file", "URDF or MJCF", GREY)
    body += arrow((140, 54), (90, 82)) + arrow((220, 54), (270, 82))
    body += box(8, 84, 164, 48, "Chain of joints", "kinematics", BLUE)
    body += box(188, 84, 164, 48, "Compiled model", "dynamics, pictures", BLUE)
    body += arrow((90, 132), (140, 160)) + arrow((270, 132), (220, 160))
    body += box(30, 162, 300, 48, "Batch of environments", "task: targets, observations, rewards", BLUE)
    body += arrow((90, 210), (90, 244))
    body += box(8, 246, 140, 48, "Rollout", "the policy acts", GREEN)
    body += box(212, 246, 140, 48, "PPO update", "it gets better", GREEN)
    body += arrow((148, 260), (210, 260)) + arrow((212, 280), (150, 280))
    body += arrow((282, 294), (282, 328))
    body += box(90, 330, 262, 48, "Checkpoint", "all that a resumed run needs", GREEN)
    body += arrow((180, 378), (180, 410))
    body += box(30, 412, 300, 48, "Evaluation", "held-out targets, baselines beside it", GREEN)
    ends = (("Report", "figures"), ("Film", "and plots"), ("Viewer", "browser"), ("Export", "robot"))
    for index, (title, text) in enumerate(ends):
        left = 4 + 89 * index
        body += arrow((left + 42, 460), (left + 42, 492)) + box(left, 494, 85, 48, title, text, ORANGE)
    return drawing(548, "The way of the data", body)


def rooms() -> str:
    """The folders, the ground floor at the bottom."""
    body = ""
    for index, (name, text, colour) in enumerate(reversed(ROOMS)):
        y = 6 + 36 * index
        body += f'<rect x="40" y="{y}" width="314" height="32" rx="5" fill="{colour}"/>'
        body += f'<text x="54" y="{y + 21}" class="title left">{name}</text>'
        body += f'<text x="160" y="{y + 21}" class="left">{text}</text>\n'
    bottom = 6 + 36 * len(ROOMS)
    body += arrow((20, bottom - 6), (20, 10))
    return drawing(bottom + 2, "The folders of the package, from the ground up", body)


def main() -> None:
    """Draw them."""
    for name, text in (("way", way()), ("rooms", rooms())):
        (IMAGES / f"{name}.svg").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
