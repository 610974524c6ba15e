"""PPO in one file, in CleanRL's style: an arm learns to touch a point on the table. Needs `pip install torch`."""

import argparse
import json
import math
import time
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import Tensor, nn

import reachlab
from reachlab.evaluation.episodes import make_runner

SETTINGS: dict[str, Any] = {"observation": "target+tool", "reward": "dense"}
NUM_ENVS, ROLLOUT_STEPS = 64, 64
EPOCHS, BATCH_SIZE, VALIDATION = 4, 1024, 16  # updates from one validation to the next
LEARNING_RATE = 2e-3  # at the start; it falls to 0
GAMMA, GAE_LAMBDA = 0.98, 0.9
CLIP, VALUE_WEIGHT, MAX_GRAD_NORM = 0.2, 0.5, 0.5
INITIAL_STD, HIDDEN = 0.2, 64  # half of the action box; units of a layer


def network(inputs: int, outputs: int, last_gain: float) -> nn.Sequential:
    """A perceptron with orthogonal weights."""
    layers = [nn.Linear(inputs, HIDDEN), nn.Linear(HIDDEN, HIDDEN), nn.Linear(HIDDEN, outputs)]
    for layer, gain in zip(layers, (math.sqrt(2), math.sqrt(2), last_gain), strict=True):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


class Agent(nn.Module):
    """A normal distribution of actions, and a value, of scaled observations."""

    def __init__(self, observations: Any, actions: Any) -> None:
        super().__init__()
        inputs, outputs = observations.shape[0], actions.shape[0]
        self.actor, self.critic = network(inputs, outputs, 0.01), network(inputs, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((outputs,), math.log(INITIAL_STD)))
        self.sums = torch.zeros(3, inputs, dtype=torch.float64)  # of ones, observations and their squares

    def scaled(self, observation: np.ndarray, *, watch: bool = False) -> Tensor:
        """The observation with the mean taken away and in standard deviations of those that were watched."""
        given = torch.tensor(observation, dtype=torch.float64)
        self.sums += watch * torch.stack([given**power for power in range(3)]).sum(1)
        mean, square = self.sums[1:] / self.sums[0]
        return ((given - mean) / (square - mean**2 + 1e-8).sqrt()).clamp(-10, 10).float()

    def policy(self, observation: Tensor) -> torch.distributions.Independent:
        """The distribution of the next action."""
        normal = torch.distributions.Normal(self.actor(observation), self.log_std.exp())
        return torch.distributions.Independent(normal, 1)


@torch.no_grad()
def collect(envs: gymnasium.vector.VectorEnv, agent: Agent, observation: Tensor) -> tuple[list[Tensor], Tensor]:
    """Observations, actions, their logarithmic probabilities, values and advantages of a rollout; what comes next."""
    seen, rewards, goes_on = [], [], []
    for _ in range(ROLLOUT_STEPS):
        policy = agent.policy(observation)
        action = policy.sample()
        seen.append((observation, action, policy.log_prob(action), agent.critic(observation)[:, 0]))
        following, reward, terminated, truncated, infos = envs.step(action.numpy())
        if truncated.any():  # only out of time: the last observation promises more; `following` is a new episode's
            last = np.stack(infos["final_obs"][truncated])
            reward[truncated] += GAMMA * agent.critic(agent.scaled(last))[:, 0].numpy()
        observation = agent.scaled(following, watch=True)
        rewards.append(torch.tensor(reward, dtype=torch.float32))
        goes_on.append(torch.tensor(~(terminated | truncated), dtype=torch.float32))
    columns = [torch.stack(column) for column in zip(*seen, strict=True)]
    values, next_value = columns[-1], agent.critic(observation)[:, 0]
    advantages, advantage = torch.zeros_like(values), torch.zeros(NUM_ENVS)
    for t in reversed(range(ROLLOUT_STEPS)):
        error = rewards[t] + GAMMA * goes_on[t] * next_value - values[t]
        advantages[t] = advantage = error + GAMMA * GAE_LAMBDA * goes_on[t] * advantage
        next_value = values[t]
    return [column.flatten(0, 1) for column in (*columns, advantages)], observation


def update(agent: Agent, optimiser: torch.optim.Optimizer, rollout: list[Tensor]) -> None:
    """Improve policy and value on a rollout."""
    for _ in range(EPOCHS):
        for chosen in torch.randperm(len(rollout[0])).split(BATCH_SIZE):
            observation, action, before, value, advantage = (column[chosen] for column in rollout)
            ratio = (agent.policy(observation).log_prob(action) - before).exp()
            weight = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            gain = torch.min(ratio * weight, ratio.clamp(1 - CLIP, 1 + CLIP) * weight).mean()
            misfit = (agent.critic(observation)[:, 0] - (value + advantage)).square().mean()
            optimiser.zero_grad()
            (VALUE_WEIGHT * misfit - gain).backward()
            nn.utils.clip_grad_norm_(agent.parameters(), MAX_GRAD_NORM)
            optimiser.step()


def main() -> None:
    """Learn until every goal of a validation is reached, evaluate on others, and print the result as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=1_000_000, help="environment steps at most")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    if args.steps < 1 or args.seed < 0:
        parser.error("steps begin at 1, and seeds at 0")
    torch.set_num_threads(1)  # the networks are small
    torch.manual_seed(args.seed)
    began = time.perf_counter()
    envs = gymnasium.make_vec("reachlab:reachlab/Reach-v0", NUM_ENVS, autoreset_mode="SameStep", **SETTINGS)
    agent = Agent(envs.single_observation_space, envs.single_action_space)
    optimiser = torch.optim.Adam(agent.parameters(), LEARNING_RATE, eps=1e-5)
    held_out = reachlab.Env(reachlab.configure("tutorial", **SETTINGS), num_envs=1000)
    act = torch.no_grad()(lambda observation: agent.actor(agent.scaled(observation)).numpy())
    runner = make_runner(held_out, act)  # compiled once
    updates = math.ceil(args.steps / (NUM_ENVS * ROLLOUT_STEPS))
    schedule = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.0, updates)
    observation = agent.scaled(envs.reset(seed=args.seed)[0], watch=True)
    done, success = 0, 0.0
    while done < updates and success < 1:
        rollout, observation = collect(envs, agent, observation)
        update(agent, optimiser, rollout)
        schedule.step()
        done += 1
        if done % VALIDATION == 0:
            success = reachlab.evaluate(held_out, act, seed=1, runner=runner).success_rate
    wall_s, steps = round(time.perf_counter() - began, 1), done * NUM_ENVS * ROLLOUT_STEPS
    report = reachlab.evaluate(held_out, act, seed=5000, runner=runner)
    judged = {"success": report.success_rate, "interval": report.success_interval}
    print(json.dumps({**judged, "steps": steps, "seed": args.seed, "wall_s": wall_s}))


if __name__ == "__main__":
    main()
