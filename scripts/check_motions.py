"""Compares the motions that a policy draws with those that were demonstrated, phase by phase: one of its must-shows.

    python scripts/check_motions.py --policy CHECKPOINT/pretrained_model --data outputs/demo/demos

At rows of demonstrations the policy draws its next motion again and again, given the row's own history. Lengths and
angles of what is drawn stand beside those of what was demonstrated, and so does how far the two are apart. Rows whose
demonstration is one of several good motions count for the distributions, not for the distance: that is taken to the
nearest of the samples.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from check_common import count, header
from numpy.typing import NDArray
from torch import Tensor

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Phase
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.manifest import read_manifest
from lerobot_adamanip.datasets.reading import load_check
from lerobot_adamanip.util.files import write_atomically

SHARES = (10, 50, 90)
"""Percentiles that tell of a distribution."""
Array = NDArray[np.float64]


def windows(policy: Any, root: Path, rows: int, seed: int) -> dict[str, Any]:
    """Returns a batch of so many rows, terminal ones left out, with the windows that the policy wants."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset(f"local/{root.name}", root=root)
    policy._attach_dataset(dataset.meta)
    wanted = np.flatnonzero(~np.asarray(dataset.hf_dataset[schema.DONE]).ravel())
    chosen = np.sort(np.random.default_rng(seed).choice(wanted, min(rows, len(wanted)), replace=False))
    return torch.utils.data.default_collate(dataset.__getitems__(chosen.tolist()))


def drawn(policy: Any, before: Any, after: Any, batch: dict[str, Any], samples: int) -> Tensor:
    """Returns actions (S, B, 10) that the policy draws at a batch of rows."""
    ready = before(batch)
    window, _, _ = policy.training_window(ready)
    with torch.no_grad():
        found = [after(policy.head.sample(policy._active_model(), window, None)[:, 0]) for _ in range(samples)]
    return torch.stack(found)


def motions(actions: Tensor, tools: Tensor) -> tuple[Array, Array]:
    """Poses (..., 10) and the tools (..., 10) they start from -> lengths [mm] and angles [deg]."""
    from lerobot_policy_adamanip.common.tool_frame import motion_between

    motion = motion_between(actions, tools)
    return 1e3 * motion[..., :3].norm(dim=-1).numpy(), np.degrees(motion[..., 3:6].norm(dim=-1).numpy())


def compare(batch: dict[str, Any], found: Tensor) -> dict[str, Any]:
    """Returns phase -> distributions of motions demonstrated and drawn, and how far the nearest sample is."""
    tools, shown = batch[schema.STATE][:, : schema.ACTION_DIM], batch[schema.ACTION]
    phases = batch[schema.PHASE].numpy().ravel()
    pairs = {"demonstrated": motions(shown, tools), "drawn": motions(found, tools)}
    off = motions(found, shown)
    nearest = (off[0] + off[1]).argmin(axis=0)[None]  # a millimetre counts as much as a degree
    pairs["nearest"] = tuple(np.take_along_axis(each, nearest, axis=0)[0] for each in off)
    report: dict[str, Any] = {}
    for phase in (each for each in Phase if (phases == each).any()):
        rows = phases == phase
        told = {
            name: {"mm": _spread(lengths[..., rows]), "deg": _spread(angles[..., rows])}
            for name, (lengths, angles) in pairs.items()
        }
        report[phase.name.lower()] = {"rows": int(rows.sum()), **told}
    return report


def _spread(values: Array) -> list[float]:
    return [round(float(value), 2) for value in np.percentile(values, SHARES)]


def main() -> int:
    """Compares, and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", type=Path, required=True, help="folder pretrained_model of a checkpoint")
    parser.add_argument("--data", type=Path, required=True, help="demonstrations")
    parser.add_argument("--rows", type=count, default=512, help="looked at (%(default)s)")
    parser.add_argument("--samples", type=count, default=8, help="drawn at each (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="file to write the report to")
    parser.add_argument("--json", action="store_true", help="print the report")
    options = parser.parse_args()
    load_check(options.data)
    from lerobot.policies.factory import make_pre_post_processors

    from lerobot_policy_adamanip.dp3_adaptive.modeling_dp3_adaptive import DP3AdaptivePolicy

    torch.manual_seed(options.seed)
    policy = DP3AdaptivePolicy.from_pretrained(str(options.policy)).eval()
    before, after = make_pre_post_processors(policy.config, pretrained_path=str(options.policy))
    batch = windows(policy, options.data.absolute(), options.rows, options.seed)
    found = drawn(policy, before, after, batch, options.samples)
    phases = compare(batch, found)
    report = {**header(), "category": read_manifest(manifest_path(options.data)).spec.category, "phases": phases}
    if options.out is not None:
        write_atomically(options.out, json.dumps(report, indent=1).encode())
    if options.json:
        sys.stdout.write(json.dumps(report) + "\n")
        return 0
    for phase, row in phases.items():
        sys.stdout.write(f"{phase:9} {row['rows']:4} rows; 10, 50, 90 %\n")
        for name in ("demonstrated", "drawn", "nearest"):
            sys.stdout.write(f"    {name:12} {row[name]['mm']} mm  {row[name]['deg']} degrees\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
