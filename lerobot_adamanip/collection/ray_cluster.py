"""Connecting to a Ray cluster: to one of this machine's own, or to one that demands a token."""

from __future__ import annotations

import contextlib
import importlib.util
import ipaddress
import logging
import os
import re
import secrets
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from lerobot_adamanip.util.errors import ConfigurationError

LOCAL, AUTO = "local", "auto"
_PRIVATE = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",
}
"""Loopback stays loopback (Ray would replace it by the first interface's address), and nothing is reported anywhere."""
_PROBE_SECONDS = 30
# Ray itself tries for 20 s and then does not say why. Private, but what `ray.init` begins with.
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


def require_ray() -> None:
    """Raises `ConfigurationError` that names the extra if Ray is not installed."""
    try:
        absent = importlib.util.find_spec("ray") is None
    except ImportError:
        absent = True
    if absent:
        raise ConfigurationError(
            "Ray is not installed.",
            got="--cluster",
            allowed="ray >= 2.60, < 3, on every machine of the cluster",
            hint="pip install 'lerobot_env_adamanip[cluster]', or --part K/N, which needs no Ray",
        )


def is_loopback(address: str) -> bool:
    """Whether ``HOST:PORT`` cannot be reached from another machine."""
    host = address.rpartition(":")[0].strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def require_address(address: str) -> None:
    """Raises `ConfigurationError` unless this is ``local``, ``auto`` or ``HOST:PORT``."""
    if address not in (LOCAL, AUTO) and not re.fullmatch(r"[\w\[][\w.\-\[\]:]*:\d{1,5}", address):
        raise ConfigurationError(
            "No such cluster.", got=repr(address), allowed="local, auto, or HOST:PORT", hint="--cluster 10.0.0.5:6379"
        )


def require_token(environment: Mapping[str, str]) -> None:
    """Raises `ConfigurationError` unless Ray is told to authenticate, and with what.

    Ray runs any code that is sent to its ports.
    """
    default = Path.home() / ".ray" / "auth_token"
    path = Path(environment.get("RAY_AUTH_TOKEN_PATH") or default)
    if environment.get("RAY_AUTH_MODE") == "token" and (environment.get("RAY_AUTH_TOKEN") or path.is_file()):
        return
    raise ConfigurationError(
        "This cluster can be reached over a network, and no token is set.",
        got=f"RAY_AUTH_MODE={environment.get('RAY_AUTH_MODE', '')}",
        allowed="RAY_AUTH_MODE=token and RAY_AUTH_TOKEN_PATH (or RAY_AUTH_TOKEN), on every machine and here",
        hint="\n           ".join(
            (
                "ray get-auth-token --generate   (once; then copy ~/.ray/auth_token to every machine)",
                "export RAY_AUTH_MODE=token RAY_AUTH_TOKEN_PATH=~/.ray/auth_token",
                "ray stop; ray start ...   (on every machine, then the same command here)",
                "or --insecure-cluster, where nobody else reaches its ports",
            )
        ),
    )


def require_usable(address: str, *, insecure: bool) -> None:
    """Raises `ConfigurationError` for what can be told without asking the cluster. See `connected`."""
    require_ray()
    require_address(address)
    if not insecure and (address == AUTO or (address != LOCAL and not is_loopback(address))):
        require_token(os.environ)


@contextlib.contextmanager
def connected(address: str, *, workers: int, insecure: bool) -> Iterator[int]:
    """Connects this process to a cluster, and yields how many CPUs that has.

    Args:
        address: ``HOST:PORT``; ``auto`` for the one this machine belongs to; ``local`` for one of this machine alone,
            which is started, listens on loopback only, demands a random token, and ends afterwards.
        workers: CPUs of a local one; 0 for all of this machine's.
        insecure: go on without a token.

    Raises:
        ConfigurationError: there is no Ray or no such cluster, it is open, or it refuses the token.
    """
    require_usable(address, insecure=insecure)
    _set_environment(address)
    import ray

    if ray.is_initialized():
        yield _cpus()
        return
    if address == LOCAL:
        cpus = workers or os.cpu_count()
        ray.init(LOCAL, num_cpus=cpus, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
    else:
        _connect(address, insecure=insecure)
    try:
        yield _cpus()
    finally:
        ray.shutdown()


def _cpus() -> int:
    import ray

    return int(ray.cluster_resources().get("CPU", 0))  # type: ignore[no-untyped-call,unused-ignore]


def _set_environment(address: str) -> None:
    """Sets what Ray and the processes it starts read from the environment; so a token is in no command line.

    Ray reads it once, when it is imported, so it stays for the life of this process.
    """
    for name, value in _PRIVATE.items():
        os.environ.setdefault(name, value)
    if address == LOCAL and "ray" not in sys.modules:
        os.environ.update(RAY_AUTH_MODE="token", RAY_AUTH_TOKEN=secrets.token_hex(32))


def _connect(address: str, *, insecure: bool) -> None:
    import ray

    found = _address_of_this_machine() if address == AUTO else address
    match _answer(found, os.environ):
        case "refused":
            raise ConfigurationError(
                "The cluster refuses the token.",
                got=f"{found}, RAY_AUTH_MODE={os.environ.get('RAY_AUTH_MODE', '')}",
                allowed="the token that it was started with",
                hint="export RAY_AUTH_MODE=token RAY_AUTH_TOKEN_PATH=FILE, with a copy of its ~/.ray/auth_token",
            )
        case "open":
            pass
        case told:
            raise ConfigurationError(
                "The cluster cannot be reached.",
                got=f"{found}: {told}",
                allowed="a cluster that runs",
                hint="ray status",
            )
    if not insecure and not is_loopback(found):
        require_closed(found)
    try:
        ray.init(found, log_to_driver=False, logging_level=logging.ERROR)
    except (ConnectionError, RuntimeError) as error:  # another Python or another Ray, which Ray says itself
        raise ConfigurationError(
            "Cannot join the cluster.",
            got=str(error).strip(),
            allowed="one of the same Python and Ray",
            hint="the same versions on every machine",
        ) from error


def require_closed(address: str) -> None:
    """Raises `ConfigurationError` if the cluster answers without its token."""
    bare = {name: value for name, value in os.environ.items() if not name.startswith("RAY_AUTH")}
    if _answer(address, {**bare, "RAY_AUTH_MODE": "disabled"}) == "open":
        raise ConfigurationError(
            "This cluster is open: anyone who reaches its ports runs code on it.",
            got=f"{address} answers without a token",
            allowed="one whose every `ray start` had RAY_AUTH_MODE=token and a token",
            hint="restart it with both set, or --insecure-cluster where nobody else reaches its ports",
        )


def _answer(address: str, environment: Mapping[str, str]) -> str:
    """Returns ``open``, ``refused``, or why there was no answer; asked in a process of its own, for Ray asks once."""
    line = [sys.executable, "-c", _PROBE, address]
    try:
        done = subprocess.run(
            line, env=dict(environment), capture_output=True, text=True, check=False, timeout=_PROBE_SECONDS
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {_PROBE_SECONDS} s"
    told = [line for line in (done.stdout or done.stderr).strip().splitlines() if line]
    return told[-1] if told else f"exit status {done.returncode}"


def _address_of_this_machine() -> str:
    from ray._private.services import canonicalize_bootstrap_address

    found = canonicalize_bootstrap_address(AUTO)
    if not found:
        raise ConfigurationError(
            "This machine belongs to no cluster.",
            got="--cluster auto",
            allowed="after `ray start`",
            hint="--cluster local",
        )
    return str(found)
