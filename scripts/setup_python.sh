#!/usr/bin/env bash
# Creates .venv with Python 3.12 and installs the project with the pinned packages of constraints.txt. A missing Python is
# installed as root from the distribution. With NO_SYSTEM=1 the script only prints the command.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export PIP_DISABLE_PIP_VERSION_CHECK=1

WANTED=3.12
VENV=.venv

source scripts/setup_common.sh

# A pyenv shim exists for every Python ever installed, but may fail when called. So run it.
is_wanted() { [[ "$("$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null || true)" == "$WANTED" ]]; }

find_python() {
    local candidate
    for candidate in "${PYTHON:-}" "python$WANTED" python3 python \
        "${PYENV_ROOT:-$HOME/.pyenv}"/versions/"$WANTED"*/bin/python \
        "/opt/python/$WANTED"*/bin/python "$HOME"/.local/share/uv/python/cpython-"$WANTED"*/bin/python \
        "/usr/local/bin/python$WANTED" "${CONDA_PREFIX:-/nonexistent}/bin/python"; do
        if [[ -n "$candidate" ]] && has "$candidate" && is_wanted "$candidate"; then
            command -v "$candidate"
            return 0
        fi
    done
    return 1
}

# Installs the distribution's Python 3.12 (Ubuntu 24.04 has it) and Debian's separate venv module.
apt_python() {
    can_install || return 1
    announce "python$WANTED python$WANTED-venv, if this distribution has them"
    update
    [[ -n "$(apt-cache pkgnames "python$WANTED-venv" 2>/dev/null)" ]] || return 1
    install "python$WANTED" "python$WANTED-venv"
}

explain_missing() {
    cat >&2 <<TEXT
error: no Python $WANTED found.
  got:     $(python3 --version 2>/dev/null || echo "no python3")
  allowed: Python $WANTED. LeRobot needs 3.12 or newer; ManiSkill's mplib and fpsample have no wheels for 3.13 yet.
  try:     one of
             curl -LsSf https://astral.sh/uv/install.sh | sh    (make setup then lets uv fetch Python; no root needed)
             pyenv install $WANTED
             apt-get install python$WANTED python$WANTED-venv        (Ubuntu 24.04)
           then run make again, or name one: PYTHON=/path/to/python$WANTED make setup
TEXT
}

create_venv() {
    local python
    if ! python=$(find_python); then
        # uv has its own Python; otherwise the distribution may have one.
        if has uv && uv venv --quiet --clear --seed --python "$WANTED" "$VENV"; then return 0; fi
        apt_python && python=$(find_python) || { explain_missing; exit 1; }
    fi
    [[ ! -e "$VENV" ]] || say "replacing $VENV, which has another Python"
    say "creating $VENV with $("$python" --version) ($python)"
    "$python" -m venv --clear "$VENV" >/dev/null 2>&1 && return 0
    # Debian and Ubuntu ship ensurepip in a separate package.
    if has uv && uv venv --quiet --clear --seed --python "$python" "$VENV"; then return 0; fi
    apt_python && "$python" -m venv --clear "$VENV" && return 0
    rm -rf "$VENV"
    echo "error: $python cannot create virtual environments; try: apt-get install python$WANTED-venv" >&2
    exit 1
}

install_project() {
    local what=(-e '.[sim,annotate,assets,cluster,docs,dev]' -c constraints.txt)
    say "installing the project and its dependencies (6.6 GB; a few minutes the first time)"
    if has uv; then
        # pip may be configured for a mirror that uv does not know.
        uv pip install --quiet --python "$VENV/bin/python" "${what[@]}" && return 0
        say "uv failed (see above); trying pip"
    fi
    "$VENV/bin/python" -m pip install --quiet --no-input "${what[@]}"
}

[[ -x "$VENV/bin/python" ]] && is_wanted "$VENV/bin/python" || create_venv
install_project
say "installed: $("$VENV/bin/adamanip" --version)"
