"""Connection to a Ray cluster (local, or protected by a token), and the version check of its nodes."""

from __future__ import annotations

import contextlib
import importlib.metadata
import importlib.util
import ipaddress
import logging
import os
import platform
import re
import secrets
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from lerobot_adamanip.util.errors import ConfigurationError

LOCAL, AUTO = "local", "auto"
EQUAL = ("lerobot_env_adamanip", "lerobot", "mani_skill", "sapien", "numpy", "torch", "embreex", "fpsample", "scipy")
"""Distributions that must have the driver's version on every node, because they may affect episodes."""
# Keep the loopback address, which Ray would replace by the first interface's, and send no usage statistics.
_RAY_SETTINGS = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",
}
_PROBE_SECONDS = 30
# `ray.init` tries for 20 s and then gives no reason. This private client is its first call.
_PROBE = """
import sys
from ray._raylet import GcsClient
from ray.exceptions import AuthenticationError
try:
    GcsClient(address=sys.argv[1]).get_all_node_info()
except AuthenticationError:
    print("refused")
else:
    print("open")
"""
_SET_A_TOKEN = """ray get-auth-token --generate   (once; then copy ~/.ray/auth_token to every machine)
           export RAY_AUTH_MODE=token RAY_AUTH_TOKEN_PATH=~/.ray/auth_token
           ray stop; ray start ...   (on every machine, then the same command here)
           or use --insecure-cluster, if no one else can reach its ports"""


def node_versions() -> dict[str, str]:
    """Returns this machine's versions of `EQUAL`, and its name as ``host``."""
    versions = {"host": platform.node()}
    for name in EQUAL:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return versions


def require_equal_versions(driver: Mapping[str, str], node: Mapping[str, str]) -> None:
    """Raises `ConfigurationError` naming each package whose version on a node differs from the driver's."""
    if different := [name for name in EQUAL if driver[name] != node[name]]:
        raise ConfigurationError(
            f"A node of the cluster has other versions: {', '.join(different)}.",
            got=f"{node['host']}: " + "; ".join(f"{name} {node[name]}" for name in different),
            allowed="; ".join(f"{name} {driver[name]}" for name in different) + ", as on this machine",
            hint="install the same packages on every node (pip install -c constraints.txt), then start it again",
        )


def is_loopback(address: str) -> bool:
    """Returns whether other machines cannot reach ``HOST:PORT``."""
    host = address.rpartition(":")[0].strip("[]")
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def require_usable(address: str, *, insecure: bool) -> None:
    """Raises `ConfigurationError` for mistakes that can be detected without the cluster. See `connected`."""
    if importlib.util.find_spec("ray") is None:
        raise ConfigurationError(
            "Ray is not installed.",
            got="--cluster",
            allowed="ray >= 2.60, < 3, on every machine of the cluster",
            hint="pip install 'lerobot_env_adamanip[cluster]', or --part K/N, which needs no Ray",
        )
    if address not in (LOCAL, AUTO) and not re.fullmatch(r"[\w\[][\w.\-\[\]:]*:\d{1,5}", address):
        raise ConfigurationError(
            "No such cluster.", got=repr(address), allowed="local, auto, or HOST:PORT", hint="--cluster 10.0.0.5:6379"
        )
    if not insecure and (address == AUTO or (address != LOCAL and not is_loopback(address))):
        require_token(os.environ)


def require_token(environment: Mapping[str, str]) -> None:
    """Raises `ConfigurationError` unless Ray is set to authenticate: it runs any code that is sent to its ports."""
    path = Path(environment.get("RAY_AUTH_TOKEN_PATH") or Path.home() / ".ray" / "auth_token")
    mode = environment.get("RAY_AUTH_MODE", "")
    if mode != "token" or not (environment.get("RAY_AUTH_TOKEN") or path.is_file()):
        raise ConfigurationError(
            "This cluster is reachable over the network, and no token is set.",
            got=f"RAY_AUTH_MODE={mode}",
            allowed="RAY_AUTH_MODE=token and RAY_AUTH_TOKEN_PATH (or RAY_AUTH_TOKEN), on every machine and here",
            hint=_SET_A_TOKEN,
        )


@contextlib.contextmanager
def connected(address: str, *, workers: int, insecure: bool) -> Iterator[int]:
    """Connects this process to a cluster, and yields the number of its CPUs.

    Args:
        address: ``HOST:PORT``; ``auto`` for this machine's cluster; ``local`` for a temporary cluster of this machine,
            on loopback only and with a random token.
        workers: CPUs of a local cluster; 0 for all CPUs of this machine.
        insecure: whether to continue without a token.

    Raises:
        ConfigurationError: Ray or the cluster is missing, the cluster is open, or it rejects the token.
    """
    require_usable(address, insecure=insecure)
    _set_environment(address)
    import ray

    began_here = not ray.is_initialized()
    if began_here and address == LOCAL:
        cpus = workers or os.cpu_count()
        ray.init(LOCAL, num_cpus=cpus, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
    elif began_here:
        _connect(address, insecure=insecure)
    try:
        yield int(ray.cluster_resources().get("CPU", 0))  # type: ignore[no-untyped-call,unused-ignore]
    finally:
        if began_here:
            ray.shutdown()


def _set_environment(address: str) -> None:
    """Sets the environment variables for Ray and its processes, so that no command line contains the token.

    Ray reads them once, when it is imported, so they stay for the life of this process.
    """
    for name, value in _RAY_SETTINGS.items():
        os.environ.setdefault(name, value)
    if address == LOCAL and "ray" not in sys.modules:
        os.environ.update(RAY_AUTH_MODE="token", RAY_AUTH_TOKEN=secrets.token_hex(32))


def _connect(address: str, *, insecure: bool) -> None:
    import ray

    if address == AUTO:
        from ray._private.services import canonicalize_bootstrap_address

        address = str(canonicalize_bootstrap_address(AUTO) or "")
    answer = _answer(address, os.environ) if address else "this machine belongs to none"
    if answer == "refused":
        raise ConfigurationError(
            "The cluster refuses the token.",
            got=f"{address}, RAY_AUTH_MODE={os.environ.get('RAY_AUTH_MODE', '')}",
            allowed="the token with which the cluster was started",
            hint="export RAY_AUTH_MODE=token RAY_AUTH_TOKEN_PATH=FILE, with a copy of its ~/.ray/auth_token",
        )
    if answer != "open":
        raise ConfigurationError(
            "The cluster cannot be reached.",
            got=f"{address or AUTO}: {answer}",
            allowed="a running cluster, after `ray start`",
            hint="ray status; or --cluster local",
        )
    if not insecure and not is_loopback(address):
        require_closed(address)
    try:
        ray.init(address, log_to_driver=False, logging_level=logging.ERROR)
    except (ConnectionError, RuntimeError) as error:  # another Python or another Ray, as Ray's message says
        raise ConfigurationError(
            "Cannot connect to the cluster.",
            got=str(error).strip(),
            allowed="a cluster with the same versions of Python and Ray",
            hint="install the same versions on every machine",
        ) from error


def require_closed(address: str) -> None:
    """Raises `ConfigurationError` if the cluster answers requests without a token."""
    bare = {name: value for name, value in os.environ.items() if not name.startswith("RAY_AUTH")}
    if _answer(address, {**bare, "RAY_AUTH_MODE": "disabled"}) == "open":
        raise ConfigurationError(
            "This cluster is open: anyone who reaches its ports runs code on it.",
            got=f"{address} answers without a token",
            allowed="a cluster with RAY_AUTH_MODE=token and a token at every `ray start`",
            hint="restart it with both set, or use --insecure-cluster if no one else can reach its ports",
        )


def _answer(address: str, environment: Mapping[str, str]) -> str:
    """Returns ``open``, ``refused``, or the failure; runs in its own process, because Ray reads the token only once."""
    line = [sys.executable, "-c", _PROBE, address]
    try:
        done = subprocess.run(
            line, env=dict(environment), capture_output=True, text=True, check=False, timeout=_PROBE_SECONDS
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {_PROBE_SECONDS} s"
    lines = [line for line in (done.stdout or done.stderr).strip().splitlines() if line]
    return lines[-1] if lines else f"exit status {done.returncode}"
