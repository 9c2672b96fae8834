"""Refinement: a pose is led to what was shown, wherever that stands, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from lerobot_adamanip.contract.rotations import rotation_6d_from_matrix
from lerobot_policy_adamanip.common.geometry import motion_between, pose_after
from lerobot_policy_adamanip.dp3_adaptive import truncated
from lerobot_policy_adamanip.dp3_adaptive.truncated import Refiner

PLATE = (0.2, 0.1, 0.05)
"""A place beside a wedge, in its frame [m]."""
Scene = tuple[Tensor, Tensor]
NO_INSTRUCTION = torch.zeros(16, 0)


def scenes(shape: np.ndarray, draw: np.random.Generator, *, swapped: bool = False) -> Scene:
    """Clouds of 16 shapes (N, 3) somewhere, and goals at their origins, half of them with swapped fingers."""
    turns, places = Rotation.random(16, random_state=int(draw.integers(1 << 30))), draw.uniform(-0.5, 0.5, (16, 3))
    clouds = np.stack([turn.apply(shape) + place for turn, place in zip(turns, places, strict=True)])
    grasps = turns * Rotation.from_euler("z", np.pi * (draw.integers(2, size=16) * swapped)[:, None])
    goals = np.c_[places, rotation_6d_from_matrix(grasps.as_matrix()), np.ones(16)]
    return torch.from_numpy(clouds).float(), torch.from_numpy(goals).float()


def taught(shown: list[Scene], *, steps: int, instruction: Tensor = NO_INSTRUCTION) -> Refiner:
    """Returns a refiner after training on scenes."""
    refiner = Refiner(3, 48, instruction.shape[1])
    optimizer = torch.optim.AdamW(refiner.parameters(), lr=3e-3)
    for step in range(steps):
        optimizer.zero_grad()
        refiner.loss(*shown[step % len(shown)], instruction).mean().backward()
        optimizer.step()
    return refiner.eval().requires_grad_(False)


def test_fingers_are_turned_across_a_bar_whichever_way_they_were_shown() -> None:
    """Of two grasps that are alike either may have been demonstrated; a quarter turn away none is nearer."""
    torch.manual_seed(0)
    draw = np.random.default_rng(0)
    side, along = np.meshgrid(np.linspace(-0.006, 0.006, 3), np.linspace(-0.05, 0.05, 16))
    bar = np.c_[along.ravel(), side.ravel(), np.zeros(48)]
    bars = taught([scenes(bar, draw, swapped=True) for _ in range(8)], steps=450)
    cloud, goal = scenes(bar, draw, swapped=True)
    twist = torch.zeros(16, 7)
    twist[:, 5] = torch.linspace(-np.pi / 2, np.pi / 2, 16)
    found = bars.refined(cloud, pose_after(twist, goal), NO_INSTRUCTION)
    left = motion_between(found, goal)[:, 5].abs()
    assert (torch.minimum(left, np.pi - left) < 0.25).float().mean() > 0.9


def wedges(draw: np.random.Generator) -> Scene:
    """Wedges, whose corner is the goal, each beside a plate of 10 cm that nothing is done with."""
    plane = np.stack(np.meshgrid(np.linspace(0, 0.08, 7), np.linspace(0, 0.05, 6)), axis=-1).reshape(-1, 2)
    wedge = np.concatenate([np.c_[plane, np.zeros(42)], np.c_[plane[:, 0], np.zeros(42), plane[:, 1]]])
    return scenes(np.concatenate([wedge, np.c_[plane * (1.2, 2), np.zeros(42)] + PLATE]), draw)


def near(goal: Tensor, draw: np.random.Generator) -> Tensor:
    """Poses about 2.5 cm beside goals."""
    off = torch.from_numpy(draw.normal(scale=0.015, size=(len(goal), 3))).float()
    return pose_after(torch.cat([off, torch.zeros(len(goal), 3), goal[:, 9:]], dim=1), goal)


@pytest.fixture(scope="module")
def refiner() -> Refiner:
    """Taught from poses beside the corners of wedges, on a few scenes."""
    torch.manual_seed(0)
    draw = np.random.default_rng(0)
    return taught([wedges(draw) for _ in range(4)], steps=400)


def test_a_refiner_finds_what_it_was_shown_wherever_it_stands(
    refiner: Refiner, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw = np.random.default_rng(1)
    cloud, goal = wedges(draw)
    start = near(goal, draw)
    ends = [start[:, :3]]
    for steps in (1, 3):
        monkeypatch.setattr(refiner, "steps", steps)
        ends.append(refiner.refined(cloud, start, NO_INSTRUCTION)[:, :3])
    missed = [(end - goal[:, :3]).norm(dim=-1).median().item() for end in ends]
    assert missed[0] > 0.015
    assert missed[1] < 0.5 * missed[0]
    assert missed[2] < 0.006


def test_it_tells_what_can_be_held_from_what_was_never_held(refiner: Refiner) -> None:
    draw = np.random.default_rng(2)
    cloud, goal = wedges(draw)
    beside = pose_after(torch.tensor([*PLATE, 0.0, 0.0, 0.0, 1.0]).expand(16, 7), goal)
    for place, share in ((goal, 1.0), (beside, 0.0)):
        _, logit = refiner(cloud, near(place, draw), NO_INSTRUCTION)
        assert (logit >= 0).float().mean() == pytest.approx(share, abs=0.1)


def test_the_instruction_says_which_of_two_places_is_wanted() -> None:
    """A goal at the corner of a wedge or, by the instruction, 4 cm along its edge."""
    torch.manual_seed(0)
    draw = np.random.default_rng(4)
    instruction = torch.tensor([[0.0], [1.0]]).repeat(8, 1)
    along = torch.tensor([0.04, 0, 0, 0, 0, 0, 1]) * torch.cat([instruction.expand(-1, 6), torch.ones(16, 1)], dim=1)
    shown = [(cloud, pose_after(along, corner)) for cloud, corner in (wedges(draw) for _ in range(8))]
    trained = taught(shown, steps=400, instruction=instruction)
    cloud, corner = wedges(draw)
    goal, other = (pose_after(each, corner)[:, :3] for each in (along, along.flip(0)))
    found = trained.refined(cloud, near(corner, draw), instruction)
    missed, missed_other = ((found[:, :3] - each).norm(dim=-1).median() for each in (goal, other))
    assert missed < 0.01
    assert missed_other > 0.03


@pytest.mark.parametrize("reach", [0.003, 0.02, 0.1])
def test_no_pose_is_shifted_beyond_the_reach(refiner: Refiner, monkeypatch: pytest.MonkeyPatch, reach: float) -> None:
    draw = np.random.default_rng(3)
    cloud, goal = wedges(draw)
    start = near(goal, draw)
    monkeypatch.setattr(truncated, "REACH_M", 10.0)
    free = refiner.refined(cloud, start, NO_INSTRUCTION)
    monkeypatch.setattr(truncated, "REACH_M", reach)
    found = refiner.refined(cloud, start, NO_INSTRUCTION)
    wanted, shift = (each[:, :3] - start[:, :3] for each in (free, found))
    length = wanted.norm(dim=-1)
    assert (shift.norm(dim=-1) <= reach + 1e-6).all()
    torch.testing.assert_close(shift, wanted * (reach / length).clamp(max=1)[:, None], rtol=0, atol=1e-6)
    assert torch.equal(found[:, 3:], free[:, 3:])
    assert torch.equal(found[:, 9], start[:, 9])
