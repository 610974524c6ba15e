"""Names of the topics of ROS 2."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Topics:
    """Names of the topics."""

    joint_states: str = "joint_states"
    """Measured joints, `sensor_msgs/JointState`, in any order."""
    goals: str = "reachlab/goal"
    """Goals, `geometry_msgs/PoseStamped`, in the frame of `goal.frame` in policy.json."""
    reached: str = "reachlab/reached"
    """Each goal, as it was asked for, `geometry_msgs/PoseStamped`, once it is reached and held as for a success."""
    problems: str = "reachlab/problem"
    """What is wrong, in words, `std_msgs/String`, when that begins; empty when all is well again."""
    objects: str = "reachlab/object"
    """Where the object is, `geometry_msgs/PoseStamped`, in the same frame; its header says when it was seen there."""
    obstacles: str = "reachlab/obstacles"
    """All obstacles, `visualization_msgs/MarkerArray`, in that frame: spheres, cubes, and cylinders for capsules."""
    wrenches: str = "force_torque_sensor_broadcaster/wrench"
    """What a sensor at the wrist measures, `geometry_msgs/WrenchStamped`: force and torque with which all that the last
    joint holds acts on the arm, in the frame of the last moving link."""
    commands: str = "forward_position_controller/commands"
    """Joint commands, `std_msgs/Float64MultiArray`, in the order of the policy's joints."""
    reset: str = "reachlab/reset"
    """`std_msgs/Empty`: begin anew from where the arm is measured to rest, without a goal; also after a stop."""
    stop: str = "reachlab/stop"
    """`std_msgs/Empty`: brake, and stay at rest until a reset."""
    trajectories: str = "joint_trajectory_controller/joint_trajectory"
    """With `--trajectory`, `trajectory_msgs/JointTrajectory`."""
