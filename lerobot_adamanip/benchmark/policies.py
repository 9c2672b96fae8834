"""Policies of a benchmark's methods in this installation: availability, and hashes of their code.

Imports LeRobot with all policy configurations on the first call.
"""

from __future__ import annotations

import contextlib
import inspect
import io
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lerobot_adamanip.benchmark.declaration import Method
from lerobot_adamanip.util.errors import AdaManipError
from lerobot_adamanip.util.fingerprint import DECIDES_NOTHING, code_hash
from lerobot_adamanip.util.import_graph import ImportGraph, is_within, our_import_graph


def find_policies(methods: Mapping[str, Method]) -> tuple[dict[str, str], dict[str, str]]:
    """Returns method -> hash of its policy's code, and method -> reason why it cannot run here."""
    import lerobot.policies  # noqa: F401  (registers LeRobot's own)
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    known: Mapping[str, type[Any]] = PreTrainedConfig.get_known_choices()
    methods = {name: method for name, method in methods.items() if method.policy}
    hashes = {name: policy_hash(known[name]) for name in {method.policy for method in methods.values()} & known.keys()}
    code, unavailable = dict[str, str](), dict[str, str]()
    for name, method in methods.items():
        if method.policy not in known:
            unavailable[name] = f"no policy {method.policy!r} is installed"
        elif reason := _refusal(known[method.policy], method.options):
            unavailable[name] = reason
        else:
            code[name] = hashes[method.policy]
    return code, unavailable


def policy_hash(configuration: type[Any]) -> str:
    """Returns a hash of the code that decides how a policy learns and acts.

    It covers the import closure of the configuration's folder, within this project's packages and the package of that
    folder. The ``__init__`` of that package does not count, because it changes with each new policy.
    """
    folder, package = Path(inspect.getfile(configuration)).parent, configuration.__module__.rpartition(".")[0]
    ours, parent = our_import_graph(), package.rpartition(".")[0]
    own = {parent: folder.parent} if parent else {package: folder}
    graph = ours if is_within(package, ours.roots) else ImportGraph({**ours.roots, **own})
    entries = [name for name in graph.modules if is_within(name, (package,))]
    return code_hash(graph.closure(entries, DECIDES_NOTHING), graph)


def _refusal(kind: type[Any], options: tuple[str, ...]) -> str:
    """Returns why a policy rejects these options; empty if it accepts them."""
    import draccus

    said = io.StringIO()
    arguments = ["--device=cpu", *(f"--{option.removeprefix('--policy.')}" for option in options)]
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)  # configurations log the device
    try:
        with contextlib.redirect_stderr(said):
            draccus.parse(config_class=kind, args=arguments)
    except SystemExit:  # argparse exits on an unknown option, after printing the reason
        return said.getvalue().strip().rpartition("error: ")[2]
    except AdaManipError as error:
        return " ".join(str(error).split())
    except draccus.utils.DraccusException as error:
        return " ".join(str(error.__cause__ or error).split())
    finally:
        logging.disable(before)
    return ""
