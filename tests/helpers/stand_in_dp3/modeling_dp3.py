"""The stand-in: a maximum over the points' features beside the state, and a chunk of actions by regression."""

from __future__ import annotations

from collections import deque

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot_policy_stand_in.configuration_dp3 import DP3Config

CLOUD, STATE = "observation.pointcloud", "observation.state"


class DP3Policy(PreTrainedPolicy):
    """Refuses a cloud that is not in metres, or not of as many steps as the state."""

    config_class, name = DP3Config, "dp3"

    def __init__(self, config: DP3Config, **kwargs):
        super().__init__(config)
        config.validate_features()
        steps, state = config.n_obs_steps, config.robot_state_feature.shape[0]
        self.points = torch.nn.Sequential(torch.nn.Linear(3, 16), torch.nn.LayerNorm(16), torch.nn.ReLU())
        self.actions = torch.nn.Linear(steps * (16 + state), config.horizon * config.action_feature.shape[0])
        self.reset()

    def get_optim_params(self):
        return self.parameters()

    def reset(self):
        self.seen = {key: deque(maxlen=self.config.n_obs_steps) for key in (CLOUD, STATE)}

    def chunk(self, cloud, state):
        assert cloud.dtype == torch.float32
        assert cloud.dim() == 4
        assert cloud.shape[-1] == 3
        assert cloud.shape[:2] == state.shape[:2] == (len(cloud), self.config.n_obs_steps)
        features = torch.cat([self.points(cloud).amax(dim=2), state], dim=-1).flatten(1)
        return self.actions(features).unflatten(1, (self.config.horizon, -1))

    def forward(self, batch):
        error = (self.chunk(batch[CLOUD], batch[STATE]) - batch["action"]).square().mean(dim=-1)
        return error[~batch["action_is_pad"]].mean(), {"farthest": float(batch[CLOUD].abs().amax())}

    def predict_action_chunk(self, batch, **kwargs):
        for key, seen in self.seen.items():
            seen.extend([batch[key]] * (1 if seen else self.config.n_obs_steps))
        return self.chunk(*(torch.stack(list(seen), dim=1) for seen in self.seen.values()))

    def select_action(self, batch, **kwargs):
        return self.predict_action_chunk(batch)[:, 0]
