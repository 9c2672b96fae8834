"""Searches text for tokens, keys, passwords, and addresses of machines and people. Sends nothing."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterator
from typing import Any

from detect_secrets.core.plugins.initialize import from_plugin_classname

_PLUGINS = (
    "AWSKeyDetector", "AzureStorageKeyDetector", "BasicAuthDetector", "DiscordBotTokenDetector", "GitHubTokenDetector",
    "GitLabTokenDetector", "JwtTokenDetector", "NpmDetector", "PrivateKeyDetector", "PypiTokenDetector",
    "SendGridDetector", "SlackDetector", "SquareOAuthDetector", "StripeDetector", "TelegramBotTokenDetector",
    "TwilioKeyDetector",
)  # fmt: skip
"""Detectors whose patterns match nothing else. Those by entropy or by words would match hashes of files and commits."""
_DETECTORS: tuple[Any, ...] = tuple(map(from_plugin_classname, _PLUGINS))
_NAME = r"(?:api|access|secret|private|auth|client|wandb|hf|hub)[_-]?(?:key|token|secret)|passw(?:or)?d|passphrase"
_NO_VALUE = r"(?:os\.|environ|none|null|true|false|your|example|x{4}|\*{4})"
_OWN = {
    "Hugging Face token": r"(?<![A-Za-z0-9])(?:hf|api_org)_[A-Za-z0-9]{30,}",
    "API key": r"(?<![\w-])sk-(?=[\w-]*\d)[\w-]{20,}",  # OpenAI, Anthropic, OpenRouter
    "GitHub token": r"github_pat_\w{22,}",
    "Google API key": r"(?<![\w-])AIza[\w-]{35}",
    "NVIDIA API key": r"(?<![\w-])nvapi-[\w-]{30,}",
    "Replicate token": r"(?<!\w)r8_[A-Za-z0-9]{37}",
    "W&B key": r"(?<!\w)wandb_v\d_\w{30,}|(?i:wandb|api_?key|token|password)\W{1,6}[0-9a-f]{40}(?![0-9a-f])",
    "password": rf"(?i)(?:{_NAME})[\"']?\s*[:=]\s*[\"']?(?!{_NO_VALUE})[^\s\"'<>{{}}$,;()\[\]]{{8,}}",
}
"""Kind of secret that detect-secrets does not know -> its pattern."""


def find_secrets(text: str) -> Iterator[tuple[str, str]]:
    """Yields kind and first letters of each secret in a text. The rest stays out of error messages."""
    for name, pattern in _OWN.items():
        for match in re.finditer(pattern, text):
            yield name, _shortened(match.group())
    for detector in _DETECTORS:
        for secret in detector.analyze_string(text):
            yield detector.secret_type, _shortened(secret)


def _shortened(secret: str) -> str:
    return f"{secret[:6]}..."


_IPV4 = re.compile(r"(?<![\w.])\d{1,3}(?:\.\d{1,3}){3}(?![\w-]|\.\d)")
_IPV6 = re.compile(r"(?<![\w:.])[0-9A-Fa-f]{0,4}(?::[0-9A-Fa-f]{0,4}){2,7}(?![\w:])")
_EMAIL = re.compile(r"(?<![\w.+-])[\w.+-]+@(?:[A-Za-z0-9-]+\.)+[A-Za-z]{2,}(?![\w-])")
_HOST = re.compile(
    r"(?<![\w.-])(?:ip-\d{1,3}(?:-\d{1,3}){3}(?:\.[\w-]+)*"
    r"|(?:[A-Za-z0-9-]+\.)+(?:lan|corp|intranet|localdomain|home\.arpa)"
    r"|(?=[\w-]*[\d-])[A-Za-z0-9-]+\.(?:[A-Za-z0-9-]+\.)*(?:local|internal)"
    r"|(?:[A-Za-z0-9-]+\.){2,}(?:local|internal))(?![\w-]|\.\w)"
)
_NAMED_HOST = re.compile(r"(?:hostname|host_name|nodename|node_name)[\"']?\s*[:=]\s*[\"']?([A-Za-z0-9][\w.-]+)", re.I)
_VERSION_BEFORE = re.compile(r"(?:[=<>~!]=\s*|\bv(?:ersion)?[ .:=]*|[\w.]-)$", re.I)
"""Text directly before a version number of four parts."""
_ADDRESS_BEFORE = re.compile(
    r"(?:://|@|\b(?:ip|ipv4|inet|addr|address|host|node|server|gateway|peer|client|dns|ping|ssh|from|to|at)\b\W{0,4})$",
    re.I,
)
_LOGIN_BEFORE = re.compile(r"://[^\s/@]*:$")
"""Text directly before a password in an address, which must not be shown as an e-mail address."""
_ADDRESS_BEHIND = re.compile(r":\d{2,5}\b|/\d{1,2}\b")
_PUBLIC_MAIL = ("example.com", "example.org", "example.net", "users.noreply.github.com")
_DOCUMENTATION = tuple(
    map(ipaddress.ip_network, ("192.0.2.0/24", "198.51.100.0/24", "203.0.113.0/24", "0.0.0.0/8", "2001:db8::/32"))
)
_NO_HOSTS = ("localhost", "none", "null", "true", "false")


def find_addresses(text: str) -> Iterator[tuple[str, str]]:
    """Yields kind (``address``, ``e-mail`` or ``host``) and text of addresses of machines and people.

    A number of four parts may be a version. It counts as an address in two cases: it is in a private network and has
    no version mark such as ``==`` before it, or nearby words or a port indicate an address. Loopback, unspecified and
    documentation addresses are ignored.
    """
    for match in _IPV4.finditer(text):
        if _is_ipv4(match.group(), text[max(0, match.start() - 24) : match.start()], text[match.end() :][:8]):
            yield "address", match.group()
    for match in _IPV6.finditer(text):
        if _is_ipv6(match.group()):
            yield "address", match.group()
    for match in _EMAIL.finditer(text):
        name, _, domain = match.group().partition("@")
        is_password = _LOGIN_BEFORE.search(text[max(0, match.start() - 200) : match.start()])
        if domain.lower() not in _PUBLIC_MAIL and name != "git" and not is_password:
            yield "e-mail", match.group()
    for match in _HOST.finditer(text):
        yield "host", match.group()
    for match in _NAMED_HOST.finditer(text):
        if match[1].lower() not in _NO_HOSTS and not match[1][0].isdigit():
            yield "host", match[1]


def _is_ipv4(candidate: str, before: str, behind: str) -> bool:
    address = _private_or_public(candidate)
    if address is None:
        return False
    if _ADDRESS_BEFORE.search(before) or _ADDRESS_BEHIND.match(behind):
        return True
    return not address.is_global and not _VERSION_BEFORE.search(before)


def _is_ipv6(candidate: str) -> bool:
    address = _private_or_public(candidate)
    if address is None:
        return False
    groups = [group for group in candidate.split(":") if group]
    # Two groups and a gap are more often a slice or a C++ name than an address.
    return len(groups) > 2 or address.is_link_local or candidate.lower().startswith(("fc", "fd"))


def _private_or_public(candidate: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Returns the address; None for other text or a loopback, unspecified, multicast or documentation address."""
    try:
        address = ipaddress.ip_address(candidate)
    except ValueError:
        return None
    special = address.is_loopback or address.is_unspecified or address.is_multicast
    reserved = address.version == 4 and address.is_reserved
    return None if special or reserved or any(address in network for network in _DOCUMENTATION) else address
