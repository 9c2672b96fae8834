"""A Ray cluster of two nodes on loopback, which answers nobody without a token."""

from __future__ import annotations

import os
import secrets
import sys
from pathlib import Path

# Ray reads these when it is imported. Loopback then stays loopback, and the cluster answers nobody without the token.
TOKEN = secrets.token_hex(16)
os.environ.update(
    RAY_AUTH_MODE="token", RAY_AUTH_TOKEN=TOKEN, RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER="0", RAY_USAGE_STATS_ENABLED="0"
)


class TwoNodes:
    """A cluster whose head runs nothing; nodes have a home, a folder for temporary files and a working one each."""

    def __init__(self, folder: Path) -> None:
        from ray.cluster_utils import Cluster

        self.folder, self.nodes, self.count = folder, [], 0
        quick = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 200, "health_check_failure_threshold": 3}
        head = {"num_cpus": 0, "include_dashboard": False, "_system_config": quick}
        self.cluster = Cluster(initialize_head=True, head_node_args=head)
        self.address = str(self.cluster.address)
        self.fill()

    def fill(self) -> None:
        """Brings the nodes to two."""
        before, here = dict(os.environ), Path.cwd()
        while len(self.nodes) < 2:
            self.count += 1
            own = self.folder / f"node-{self.count}"
            for name in ("home", "tmp", "work"):
                (own / name).mkdir(parents=True)
            path = os.pathsep.join(filter(None, sys.path))
            os.environ.update(HOME=str(own / "home"), TMPDIR=str(own / "tmp"), PYTHONPATH=path)
            os.chdir(own / "work")
            try:
                self.nodes.append(self.cluster.add_node(num_cpus=1))
            finally:
                os.chdir(here)
                os.environ.clear()
                os.environ.update(before)

    def power_cut(self) -> None:
        """Ends a node without a word to anybody."""
        self.cluster.remove_node(self.nodes.pop(0), allow_graceful=False)
