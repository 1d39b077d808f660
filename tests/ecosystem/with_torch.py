"""PPO in one file of plain PyTorch, as CleanRL writes it, on Gymnasium's vector interface."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import torch
from checks import check, run
from torch import nn
from torch.distributions import Normal

import uwoc_gym  # noqa: F401 - registers the IDs

ID, ENVS, STEPS = "uwoc/Random-v0", 64, 64


class Agent(nn.Module):
    """A Gaussian policy and a value."""

    def __init__(self, envs: gym.vector.VectorEnv) -> None:
        super().__init__()
        size, width = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
        self.critic = nn.Sequential(nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 1))
        self.mean = nn.Sequential(nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, width))
        nn.init.orthogonal_(self.mean[-1].weight, 0.01)
        self.log_std = nn.Parameter(torch.full((width,), -0.5))

    def distribution(self, seen: torch.Tensor) -> Normal:
        """What actions are drawn from."""
        return Normal(self.mean(seen), self.log_std.exp())


def train(iterations: int) -> list[float]:
    """PPO with 64 environments; returns the mean reward of a step in each iteration."""
    torch.manual_seed(0)
    envs = gym.make_vec(ID, num_envs=ENVS, scenario={"episode": {"duration_s": 6.0}})
    envs = gym.wrappers.vector.RecordEpisodeStatistics(envs)
    agent = Agent(envs)
    optimizer = torch.optim.Adam(agent.parameters(), lr=1e-3)
    seen, _ = envs.reset(seed=0)
    seen, fresh = torch.as_tensor(seen), torch.zeros(ENVS)
    rewarded = []
    for _ in range(iterations):
        kept: dict[str, list[torch.Tensor]] = {key: [] for key in ("seen", "action", "log", "reward", "fresh", "value")}
        for _ in range(STEPS):
            with torch.no_grad():
                policy, value = agent.distribution(seen), agent.critic(seen).squeeze(-1)
                action = policy.sample()
            values = {"seen": seen, "action": action, "log": policy.log_prob(action).sum(-1), "fresh": fresh}
            following, reward, terminated, truncated, _ = envs.step(action.numpy())
            for key, each in {**values, "value": value, "reward": torch.as_tensor(reward, dtype=torch.float32)}.items():
                kept[key].append(each)
            seen, fresh = torch.as_tensor(following), torch.as_tensor(terminated | truncated, dtype=torch.float32)
        data = {key: torch.stack(each) for key, each in kept.items()}
        with torch.no_grad():
            ahead = agent.critic(seen).squeeze(-1)
        advantage, last = torch.zeros_like(data["reward"]), torch.zeros(ENVS)
        for step in reversed(range(STEPS)):
            goes_on = 1.0 - (fresh if step == STEPS - 1 else data["fresh"][step + 1])
            following_value = ahead if step == STEPS - 1 else data["value"][step + 1]
            error = data["reward"][step] + 0.98 * following_value * goes_on - data["value"][step]
            advantage[step] = last = error + 0.98 * 0.95 * goes_on * last
        # The step after an end only begins anew: nothing was decided there.
        flown = (data["fresh"] == 0.0).flatten()
        target = (advantage + data["value"]).flatten()[flown]
        flat = {key: each.flatten(0, 1)[flown] for key, each in data.items()}
        wanted = advantage.flatten()[flown]
        for _ in range(4):
            for chosen in torch.randperm(len(wanted)).split(512):
                policy = agent.distribution(flat["seen"][chosen])
                ratio = (policy.log_prob(flat["action"][chosen]).sum(-1) - flat["log"][chosen]).exp()
                own = wanted[chosen]
                own = (own - own.mean()) / (own.std() + 1e-8)
                lost = -torch.min(ratio * own, ratio.clamp(0.8, 1.2) * own).mean()
                value = (agent.critic(flat["seen"][chosen]).squeeze(-1) - target[chosen]).pow(2).mean()
                optimizer.zero_grad()
                (lost + 0.5 * value).backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()
        rewarded.append(float(flat["reward"].mean()))
    envs.close()
    return rewarded


@check
def learns() -> str:
    """PPO of a single file learns for 40 rollouts of 64 environments."""
    rewarded = train(40)
    first, last = np.mean(rewarded[:5]), np.mean(rewarded[-5:])
    assert last > first + 0.1, f"the reward a step went from {first:.2f} to {last:.2f}"
    return f"reward a step from {first:.2f} to {last:.2f}"


if __name__ == "__main__":
    run()
