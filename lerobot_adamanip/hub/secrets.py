"""Searches text for tokens, keys and passwords. Sends nothing: no secret is tried out."""

from __future__ import annotations

import re
from collections.abc import Iterator

from detect_secrets.plugins.aws import AWSKeyDetector
from detect_secrets.plugins.azure_storage_key import AzureStorageKeyDetector
from detect_secrets.plugins.basic_auth import BasicAuthDetector
from detect_secrets.plugins.discord import DiscordBotTokenDetector
from detect_secrets.plugins.github_token import GitHubTokenDetector
from detect_secrets.plugins.gitlab_token import GitLabTokenDetector
from detect_secrets.plugins.jwt import JwtTokenDetector
from detect_secrets.plugins.npm import NpmDetector
from detect_secrets.plugins.private_key import PrivateKeyDetector
from detect_secrets.plugins.pypi_token import PypiTokenDetector
from detect_secrets.plugins.sendgrid import SendGridDetector
from detect_secrets.plugins.slack import SlackDetector
from detect_secrets.plugins.square_oauth import SquareOAuthDetector
from detect_secrets.plugins.stripe import StripeDetector
from detect_secrets.plugins.telegram_token import TelegramBotTokenDetector
from detect_secrets.plugins.twilio import TwilioKeyDetector

_DETECTORS = (
    AWSKeyDetector(),
    AzureStorageKeyDetector(),
    BasicAuthDetector(),
    DiscordBotTokenDetector(),
    GitHubTokenDetector(),
    GitLabTokenDetector(),
    JwtTokenDetector(),
    NpmDetector(),
    PrivateKeyDetector(),
    PypiTokenDetector(),
    SendGridDetector(),
    SlackDetector(),
    SquareOAuthDetector(),
    StripeDetector(),
    TelegramBotTokenDetector(),
    TwilioKeyDetector(),
)
"""Detectors whose patterns match nothing else. Those by entropy or by words would match hashes of files and commits."""
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
"""Name -> pattern of what detect-secrets does not know."""


def find_secrets(text: str) -> Iterator[tuple[str, str]]:
    """Yields the name of a kind of secret and its first letters, for the error to name it and not to spread it."""
    for name, pattern in _OWN.items():
        for match in re.finditer(pattern, text):
            yield name, _shortened(match.group())
    for detector in _DETECTORS:
        for found in detector.analyze_string(text):
            yield detector.secret_type, _shortened(found)


def _shortened(secret: str) -> str:
    return f"{secret[:6]}..."
