"""reachlab in LeRobot: environments, exported policies, and the loop around an SO-101."""

from lerobot_policy_reachlab.configuration_reachlab import ReachlabConfig
from lerobot_policy_reachlab.environment import ReachlabEnv
from lerobot_policy_reachlab.modeling_reachlab import ReachlabPolicy
from lerobot_policy_reachlab.processor_reachlab import make_reachlab_pre_post_processors

__version__ = "0.1.0"

__all__ = ["ReachlabConfig", "ReachlabEnv", "ReachlabPolicy", "make_reachlab_pre_post_processors"]
