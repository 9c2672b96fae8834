#!/usr/bin/env bash
# Sees to a Chromium for the test of the annotation page. Does nothing where there is one; installs the distribution's as
# root on Debian, else Playwright's own. Without any, that one test is skipped (and fails where CI is set): told, not fatal.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

say() { printf '== %s\n' "$*"; }
has() { command -v "$1" >/dev/null 2>&1; }

can_be_root() { [[ $EUID -eq 0 ]] || { has sudo && sudo -n true 2>/dev/null; }; }

as_root() {
    if [[ $EUID -eq 0 ]]; then DEBIAN_FRONTEND=noninteractive "$@"; else sudo -n env DEBIAN_FRONTEND=noninteractive "$@"; fi
}

# Asked for its version: Ubuntu has a command of that name that only says which snap to install.
found() {
    local candidate
    for candidate in chromium chromium-browser google-chrome google-chrome-stable; do
        if has "$candidate" && "$candidate" --version 2>/dev/null; then return 0; fi
    done
    .venv/bin/python - 2>/dev/null <<'PYTHON'
from pathlib import Path
from playwright.sync_api import sync_playwright
with sync_playwright() as playwright:
    path = Path(playwright.chromium.executable_path)
    shells = list(path.parents[2].glob("chromium_headless_shell-*/*/*headless*shell"))
    if not path.exists() and not shells:
        raise SystemExit(1)
print("Playwright's Chromium")
PYTHON
}

# Debian's package; Ubuntu's of that name is a snap in disguise, or none.
debian_chromium() {
    has apt-get && can_be_root || return 1
    [[ "$(. /etc/os-release && printf '%s' "$ID")" == debian ]] || return 1
    as_root apt-get update -qq || true
    as_root apt-get install -y -qq --no-install-recommends chromium >/dev/null
}

playwright_chromium() {
    local dependencies=()
    if has apt-get && can_be_root; then dependencies=(--with-deps); fi
    .venv/bin/playwright install "${dependencies[@]}" --only-shell chromium
}

if ! browser=$(found); then
    say "no Chromium for the test of the annotation page: installing one"
    debian_chromium || playwright_chromium || true
    browser=$(found) || browser=""
fi
if [[ -z "$browser" ]]; then
    say "no Chromium could be installed: the test of the annotation page cannot run; try: apt-get install chromium"
    exit 0
fi
say "browser: $browser"
touch .venv/.browser
