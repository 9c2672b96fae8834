"""Policies of a benchmark's methods in this installation: availability, and versions of their packages.

Imports LeRobot with all policy configurations on the first call.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import io
import logging
from collections.abc import Mapping
from typing import Any

from lerobot_adamanip.benchmark.declaration import Method
from lerobot_adamanip.util.errors import AdaManipError

OUR_PACKAGES = ("lerobot", "lerobot_adamanip", "lerobot_policy_adamanip")


def find_policies(methods: Mapping[str, Method]) -> tuple[dict[str, str], dict[str, str]]:
    """Returns method -> `policy_package`, where it has one, and method -> reason why it cannot run here."""
    import lerobot.policies  # noqa: F401  (registers LeRobot's own)
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    known: Mapping[str, type[Any]] = PreTrainedConfig.get_known_choices()
    methods = {name: method for name, method in methods.items() if method.policy}
    packages, unavailable = dict[str, str](), dict[str, str]()
    for name, method in methods.items():
        if method.policy not in known:
            unavailable[name] = f"no policy {method.policy!r} is installed"
        elif reason := _refusal(known[method.policy], method.options):
            unavailable[name] = reason
        elif package := policy_package(known[method.policy]):
            packages[name] = package
    return packages, unavailable


def policy_package(configuration: type[Any]) -> str:
    """Returns name and version of the distribution that has a policy; empty for this project's and LeRobot's.

    This project's policies are covered by `lerobot_adamanip.contract.versions.DATA_VERSION`. LeRobot's version is
    installed software, which reports compare.
    """
    package = configuration.__module__.partition(".")[0]
    if package in OUR_PACKAGES:
        return ""
    names = sorted(set(importlib.metadata.packages_distributions().get(package, ())))
    return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names)


def _refusal(kind: type[Any], options: tuple[str, ...]) -> str:
    """Returns why a policy rejects these options; empty if it accepts them."""
    import draccus

    said = io.StringIO()
    own = [option for option in options if not option.startswith("--policy.path=")]  # read by LeRobot's commands alone
    arguments = ["--device=cpu", *(f"--{option.removeprefix('--policy.')}" for option in own)]
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)  # configurations log the device
    try:
        with contextlib.redirect_stderr(said):
            draccus.parse(config_class=kind, args=arguments)
    except SystemExit:  # argparse exits on an unknown option, after printing the reason
        return said.getvalue().strip().rpartition("error: ")[2]
    except AdaManipError as error:
        return " ".join(str(error).split())
    except Exception as error:  # of draccus, of YAML, or of a configuration of another package
        return " ".join(str(error.__cause__ or error).split())
    finally:
        logging.disable(before)
    return ""
