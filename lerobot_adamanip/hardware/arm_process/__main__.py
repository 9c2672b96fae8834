"""The process of the real arm, and of a fake for tests. `ArmClient` starts it; it is no command for people."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox
from lerobot_adamanip.hardware.arm_process.program import run_server
from lerobot_adamanip.hardware.arm_process.served import BackendFactory, Served


def _fake(options: dict[str, Any], _: Mapping[str, Mailbox]) -> Served:
    from lerobot_adamanip.hardware.backends.fake import serve_fake

    return serve_fake(options)


def _franky(options: dict[str, Any], _: Mapping[str, Mailbox]) -> Served:
    from lerobot_adamanip.hardware.backends.franky import serve_franky

    return serve_franky(options)


BACKENDS: Mapping[str, BackendFactory] = {"fake": _fake, "franky": _franky}

if __name__ == "__main__":
    sys.exit(run_server(BACKENDS, sys.argv[1]))
