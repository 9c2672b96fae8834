"""What a dataset holds: `python examples/load_dataset.py outputs/demos`, which `adamanip collect` has made."""

from __future__ import annotations

import argparse

from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Outcome, Phase


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root")
    parser.add_argument("--episode", type=int, default=0)
    options = parser.parse_args()

    dataset = LeRobotDataset("local/adamanip", root=options.root, video_backend="pyav")
    episode = dataset.meta.episodes[options.episode]
    print(f"{dataset.num_episodes} episodes, {dataset.num_frames} key frames")
    print(f"episode {options.episode}: {episode['object_id']}, hidden {episode['hidden_state']}")

    # What a policy may see is under `observation.`; what is under `complementary_info.` are labels for people.
    first = dataset[episode["dataset_from_index"]]
    for key in (schema.POINT_CLOUD, schema.STATE, schema.FRONT_IMAGE, schema.ACTION):
        print(f"{key:28} {tuple(first[key].shape) if key in first else 'not in this dataset'}")
    for index in range(episode["dataset_from_index"], episode["dataset_to_index"]):
        row = dataset[index]
        phase, outcome = Phase(int(row[schema.PHASE])), Outcome(int(row[schema.OUTCOME]))
        print(f"{index:4} {phase.name:9} {outcome.name:12} failed tries so far: {int(row[schema.TRIAL])}")


if __name__ == "__main__":
    main()
