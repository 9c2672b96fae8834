#!/usr/bin/env bash
# Installs Chromium, if missing, for the test of the annotation page: Debian's package, else Playwright's download in the
# user's cache. Without Chromium that test is skipped, or fails if CI is set. NO_SYSTEM=1 installs nothing.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

source scripts/setup_common.sh

# Runs Chromium, because Ubuntu's command of that name may only print which snap to install.
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

# Debian's package. Ubuntu's package of that name installs a snap, or is missing.
debian_chromium() {
    can_install || return 1
    [[ "$(. /etc/os-release && printf '%s' "$ID")" == debian ]] || return 1
    announce chromium
    update
    install chromium >/dev/null
}

playwright_chromium() {
    local dependencies=()
    if can_install; then
        announce "the libraries Playwright's Chromium needs"
        dependencies=(--with-deps)
    fi
    say "installing Playwright's Chromium into this user's cache"
    .venv/bin/playwright install "${dependencies[@]}" --only-shell chromium
}

if ! browser=$(found); then
    say "no Chromium for the test of the annotation page"
    no_system || debian_chromium || playwright_chromium || true
    browser=$(found) || browser=""
fi
if [[ -z "$browser" ]]; then
    say "that test is left out; to run it: apt-get install chromium, or .venv/bin/playwright install chromium"
    exit 0
fi
say "browser: $browser"
touch .venv/.browser
