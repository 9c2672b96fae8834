"""A memory of `events`: what was tried and what came of it."""

from __future__ import annotations

from torch import Tensor, nn

from lerobot_policy_adamanip.common.events import EVENT_DIM


class EventMemory(nn.Module):
    """Reads `events` in order (a GRU): what failed before the last try counts as much as the last one.

    Args:
        dim: of what it remembers.
    """

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.embedding = nn.Sequential(nn.Linear(EVENT_DIM, dim), nn.ReLU())
        self.gru = nn.GRU(dim, dim, batch_first=True)

    def forward(self, happened: Tensor) -> Tensor:
        """(B, H, 16) -> (B, dim)."""
        known = happened[..., -1:]
        _, last = self.gru(self.embedding(happened) * known)
        remembered: Tensor = last[0]
        return remembered
