"""Demonstrations, and objects to act on, without a simulator: experts and policies in `kinematic.KinematicWorld`.

A cloud shows a plate for each part, as long as the fingers are wide, in front of a block; and the hand.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from kinematic import KinematicWorld, adaptive, static
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Goal, Phase
from lerobot_adamanip.contract.rotations import pose_from_vector, pose_vector, rotation_about, transform
from lerobot_adamanip.datasets.writing import add_episode_columns

REPO_ID = "local/toy"
NUM_POINTS = 160
TINY: dict[str, Any] = {
    "num_points": 120, "context_points": 64, "encoder_dims": (16, 24), "feature_dim": 32, "patch_points": 16,
    "device": "cpu", "push_to_hub": False,
}  # fmt: skip
"""Sizes of a tiny policy."""
PLATE, BLOCK, HAND = (0.03, 0.01, 0.004), (0.1, 0.1, 0.03), (0.01, 0.04, 0.02)
"""Half sizes in the tool's frame [m]: y is where the fingers close, z the approach."""
BEHIND, ABOVE = 0.06, 0.05
"""The block is behind the part, the hand above the tool's centre [m]."""
GAVE = 0.002
"""A joint that moved by less [rad or m] did not follow."""


def toy_world(name: str, seed: int, hidden: Mapping[str, Any] | None = None) -> KinematicWorld:
    """Object ``name`` somewhere, its hidden state drawn but for what is given; each part is held one way round."""
    world = KinematicWorld(name, hidden, draw=seed, layout=seed, preset="paper")
    rng = np.random.default_rng(seed)
    yaw, x, y = np.pi + rng.uniform(-0.3, 0.3), rng.uniform(0.5, 0.8), rng.uniform(-0.2, 0.2)
    frame = transform((x, y, 0.3), rotation_about((0, 0, 1), yaw))
    world.parts = {part.name: part.in_frame(frame) for part in world.obj.parts}
    return world


def toy_cloud(world: KinematicWorld, rng: np.random.Generator, points: int = NUM_POINTS) -> NDArray[np.float32]:
    """(points, 3) [m], in random order, so that any first are a sample of the whole."""
    held = [part.moved(world.joints) for part in world.parts.values()]
    solids = [(pose, PLATE, 0.0) for pose in held] + [(part.grasp, BLOCK, BEHIND) for part in world.parts.values()]
    solids += [(world.feedback.tcp_in_base, HAND, -ABOVE)]
    which = rng.integers(len(solids), size=points)
    drawn = rng.uniform(-1, 1, (points, 3))
    cloud = np.empty((points, 3), np.float32)
    for number, (pose, half, along) in enumerate(solids):
        local = drawn[which == number] * half + (0.0, 0.0, along)
        cloud[which == number] = local @ pose[:3, :3].T + pose[:3, 3]
    return cloud


def toy_state(world: KinematicWorld) -> NDArray[np.float32]:
    """(24,): pose and gripper; joints of the arm are not modelled."""
    pose = pose_vector(world.feedback.tcp_in_base, world.feedback.gripper)
    return np.concatenate([pose, np.zeros(schema.STATE_DIM - schema.ACTION_DIM, np.float32)])


def toy_episode(world: KinematicWorld, expert: str, seed: int) -> list[dict[str, Any]]:
    """Rows of one demonstration, the final observation last: columns of the contract."""
    rng = np.random.default_rng(seed)
    frames = (adaptive if expert == "adaptive" else static)(world, seed)
    rows, goal = [], next(frames, None)
    while goal is not None and len(rows) < schema.MAX_KEY_FRAMES:
        row = _row(world, goal, rng)
        feedback = world.step(goal)
        row |= _labels(world, int(feedback.outcome or 0))
        rows.append(row)
        try:
            goal = frames.send(feedback)
        except StopIteration:
            goal = None
    here = Goal(world.feedback.tcp_in_base, rows[-1][schema.ACTION][schema.GRIPPER_DIM], Phase.OPEN)
    last = {**rows[-1], **_row(world, here, rng), schema.TRIED: np.array([-1]), schema.FAILED: np.array([False])}
    return [*rows, {**last, schema.DONE: np.array([True])}]


def _row(world: KinematicWorld, goal: Goal, rng: np.random.Generator) -> dict[str, Any]:
    joints = np.zeros(len(schema.JOINT_NAMES), np.float32)
    joints[-schema.MAX_OBJECT_JOINTS :][: len(world.joints)] = list(world.joints.values())
    return {
        schema.POINT_CLOUD: toy_cloud(world, rng).reshape(-1),
        schema.STATE: toy_state(world),
        schema.EFFORT: toy_state(world)[: schema.NUM_JOINTS],  # any numbers that vary
        schema.ACTION: goal.action(),
        schema.EXECUTED: goal.action(),
        schema.JOINTS: joints,
        schema.PHASE: np.array([int(goal.phase)]),
        schema.TRIAL: np.array([0]),
        schema.DONE: np.array([False]),
        "task": f"Open the {world.obj.category}.",
    }


def _labels(world: KinematicWorld, outcome: int) -> dict[str, Any]:
    move = world.moves[-1]
    moved = 0.0 if move is None else abs(move.end - move.start)
    return {
        schema.OUTCOME: np.array([outcome]),
        schema.TRIED: np.array([-1 if move is None else world.mechanism.joints.index(move.joint)]),
        schema.FAILED: np.array([move is not None and moved < GAVE]),
        schema.PROGRESS: np.array([moved], np.float32),
        schema.SUCCESS: np.array([world.successes[-1]]),
    }


def record_toy(root: Path, worlds: Sequence[KinematicWorld], expert: str) -> Path:
    """Records one episode in each world as a LeRobotDataset; returns its folder."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    features = schema.dataset_features(NUM_POINTS, cameras=())
    dataset = LeRobotDataset.create(REPO_ID, schema.FPS, features, root=root, use_videos=False)
    for seed, world in enumerate(worlds):
        for row in toy_episode(world, expert, seed):
            dataset.add_frame(row)
        dataset.save_episode()
    dataset.finalize()
    hidden = [json.dumps(world.hidden) for world in worlds]
    add_episode_columns(root, {"object_id": [world.obj.object_id for world in worlds], "hidden_state": hidden})
    return root


def observed(world: KinematicWorld, rng: np.random.Generator) -> dict[str, torch.Tensor]:
    """What a policy sees, as a batch of one."""
    return {
        schema.POINT_CLOUD: torch.from_numpy(toy_cloud(world, rng))[None],
        schema.STATE: torch.from_numpy(toy_state(world))[None],
    }


def play(policy: Any, world: KinematicWorld, seed: int = 0, at_most: int = 20) -> bool:
    """Lets a policy act in a world; returns whether it has opened it."""
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    policy.eval()
    policy.reset()
    for _ in range(at_most):
        pose, gripper = pose_from_vector(policy.select_action(observed(world, rng))[0].numpy())
        world.step(Goal(pose, gripper, Phase.TRY))
        if world.successes[-1]:
            return True
    return False


def trained(policy: Any, batch: dict[str, Any], steps: int, learning_rate: float = 3e-3) -> list[float]:
    """Trains a policy on one batch; returns its losses."""
    policy.train()
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    losses = []
    for _ in range(steps):
        loss, _ = policy.forward(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        losses.append(loss.item())
    policy.eval()
    return losses


def turned_and_shifted(poses: torch.Tensor, yaw: float, shift: NDArray[np.float64]) -> torch.Tensor:
    """Poses (..., 10) as they are when the scene is turned about the base's vertical [rad] and then shifted [m]."""
    turn = rotation_about((0, 0, 1), yaw)
    rows = poses.reshape(-1, schema.ACTION_DIM).double().numpy()
    moved = [pose_from_vector(row) for row in rows]
    found = [pose_vector(transform(shift, turn) @ pose, gripper) for pose, gripper in moved]
    return torch.from_numpy(np.stack(found)).reshape(poses.shape)
