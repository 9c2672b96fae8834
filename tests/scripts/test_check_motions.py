"""What the comparison of motions says of a policy that draws what was shown, half of it, or one of two."""

from __future__ import annotations

import numpy as np
import torch
from check_motions import compare

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Phase
from lerobot_adamanip.contract.rotations import pose_vector, rotation_about, transform

ROWS, PUSH = 6, 0.0178


def batch() -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Tools anywhere; half of the rows push along the tool's approach, the others turn by 30 degrees."""
    rng = np.random.default_rng(0)
    tools = [transform(rng.normal(size=3), rotation_about(rng.normal(size=3), 1.0)) for _ in range(ROWS)]
    pushes, turns = transform((0, 0, PUSH)), transform(rotation=rotation_about((0, 0, 1), np.pi / 6))
    goals = [tool @ (pushes if row % 2 else turns) for row, tool in enumerate(tools)]
    state = np.stack([np.concatenate([pose_vector(tool, 0.2), np.zeros(14)]) for tool in tools]).astype(np.float32)
    shown = torch.from_numpy(np.stack([pose_vector(goal, 0.2) for goal in goals]))
    phases = torch.tensor([[int(Phase.TRY if row % 2 else Phase.UNLOCK)] for row in range(ROWS)])
    return {
        schema.STATE: torch.from_numpy(state),
        schema.ACTION: shown,
        schema.PHASE: phases,
    }, shown


def test_what_draws_what_was_shown_is_nowhere_off() -> None:
    rows, shown = batch()
    report = compare(rows, torch.stack([shown, shown]))
    assert set(report) == {"try", "unlock"}
    for row in report.values():
        assert row["rows"] == ROWS // 2
        assert row["drawn"] == row["demonstrated"]
        np.testing.assert_allclose([row["nearest"]["mm"], row["nearest"]["deg"]], 0.0, atol=0.05)
    np.testing.assert_allclose(report["try"]["demonstrated"]["mm"], 1e3 * PUSH, atol=0.01)
    np.testing.assert_allclose(report["unlock"]["demonstrated"]["deg"], 30.0, atol=0.05)


def test_a_push_that_is_averaged_away_shows() -> None:
    rows, shown = batch()
    half = shown.clone()
    tools = rows[schema.STATE][:, :10]
    half[:, :3] = (shown[:, :3] + tools[:, :3]) / 2
    report = compare(rows, half[None])["try"]
    np.testing.assert_allclose(report["drawn"]["mm"], 500 * PUSH, atol=0.01)
    np.testing.assert_allclose(report["nearest"]["mm"], 500 * PUSH, atol=0.01)


def test_one_of_two_good_motions_is_no_error() -> None:
    rows, shown = batch()
    report = compare(rows, torch.stack([shown, shown.flip(0)]))
    assert max(report["try"]["nearest"]["mm"]) < 0.05
