"""A generated object that went abroad comes back the same, and what is proposed for it is close to what we know."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from asset_export import export_object

from lerobot_adamanip.assets import load_object
from lerobot_adamanip.assets.annotation.session import Draft
from lerobot_adamanip.catalog import make_object

NEAR = 0.035
"""Proposals are for a person to refine [m]."""


@pytest.mark.parametrize("name", ["safe_002", "safe_013", "microwave_001", "microwave_004", "bottle_003"])
def test_proposals_are_near_the_poses_we_know(tmp_path: Path, name: str) -> None:
    obj = make_object(name)
    draft = Draft(export_object(obj, tmp_path / "x1"), obj.category)
    assert draft.origin == "proposed from bounding boxes"
    draft.save()
    loaded = load_object(draft.folder, obj.category)
    np.testing.assert_allclose(loaded.size, obj.size, atol=0.08)
    ours, theirs = ([link.joint for link in each.links if link.joint] for each in (obj, loaded))
    for own, other in zip(ours, theirs, strict=True):
        assert (own.name, own.kind) == (other.name, other.kind)
        np.testing.assert_allclose(other.axis, own.axis, atol=1e-6)
        np.testing.assert_allclose(other.limits, own.limits, atol=1e-6)
    for part in obj.parts:
        found = loaded.part(part.name)
        assert [motion.joint for motion in found.motions] == [motion.joint for motion in part.motions]
        np.testing.assert_allclose(found.grasp[:3, 2], part.grasp[:3, 2], atol=1e-6)
        assert np.linalg.norm(found.grasp[:3, 3] - part.grasp[:3, 3]) < NEAR


@pytest.mark.sim
@pytest.mark.parametrize("name", ["safe_013", "microwave_004"])
def test_an_expert_opens_an_object_of_others_as_it_was_proposed(tmp_path: Path, name: str) -> None:
    from lerobot_adamanip.contract.schema import MAX_KEY_FRAMES
    from lerobot_adamanip.experts import make_expert
    from lerobot_env_adamanip.simulator import make_task

    obj = make_object(name)
    category = obj.category
    Draft(export_object(obj, tmp_path / category / "x1"), category).save()
    env = make_task(category, assets=str(tmp_path), objects="all")
    try:
        env.reset(seed=5_000_000, options={"reconfigure": True})
        assert env.simulation.obj.object_id == f"{category}:x1"
        generator, hidden = np.random.default_rng(0), env.simulation.hidden_state()
        expert = make_expert(category, "static", env.placement.annotations, generator=generator, hidden=hidden)
        goal = next(expert)
        for _ in range(MAX_KEY_FRAMES):
            felt = env.execute(goal.action())
            if env.evaluate()["success"][0]:
                break
            goal = expert.send(felt)  # StopIteration: the expert gave up
        assert env.evaluate()["success"][0]
    finally:
        env.close()
