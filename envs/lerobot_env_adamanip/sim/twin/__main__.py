"""The process of the simulated twin. A robot's client starts it; it is no command for people."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox
from lerobot_adamanip.hardware.arm_process.program import run_server
from lerobot_adamanip.hardware.arm_process.served import RESET, BackendFactory, Served
from lerobot_adamanip.util import json_fields as checked_json

_OPTIONS = checked_json.table(
    {
        "environment": checked_json.mapping(checked_json.text(r"\w{1,40}", "a name"), lambda _, value: value, 40),
        "seed": checked_json.integer(0, 2**31 - 1),
        "image_size": checked_json.integer(16, 1024),
        "depth_source": checked_json.choice(("render", "raycast")),
        "lockstep": checked_json.flag,
    }
)
_CORNER = checked_json.listing(checked_json.number(-10.0, 10.0), 3, 3)
_WORKSPACE = checked_json.table({"lower": _CORNER, "upper": _CORNER})


def _sapien(options: dict[str, Any], boxes: Mapping[str, Mailbox]) -> Served:
    """Raises ValueError, as `ConfigurationError` is one, for a wrong option."""
    from lerobot_env_adamanip.sim.twin.backend import SapienBackend, TwinOptions

    found = _OPTIONS("the twin's options", options)
    environment = found.pop("environment")
    environment["workspace"] = Workspace(**_WORKSPACE("workspace", environment["workspace"]))
    backend = SapienBackend(TwinOptions(environment=EnvironmentOptions(**environment), **found), boxes)
    handlers = {RESET: backend.reset, "look": backend.look, "episode": backend.episode}
    return Served(backend, handlers, backend.describe)


BACKENDS: Mapping[str, BackendFactory] = {"sapien": _sapien}

if __name__ == "__main__":
    sys.exit(run_server(BACKENDS, sys.argv[1]))
