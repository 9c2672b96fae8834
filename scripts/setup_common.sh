# Shared by the scripts of `make setup`. Sourced, not run.
#
# Names packages outside .venv before installing them. With NO_SYSTEM=1 they are not installed.

say() { printf '== %s\n' "$*"; }
has() { command -v "$1" >/dev/null 2>&1; }

# Whether system packages must stay unchanged.
no_system() { [[ -n "${NO_SYSTEM:-}" && "${NO_SYSTEM}" != 0 ]]; }

can_be_root() { [[ $EUID -eq 0 ]] || { has sudo && sudo -n true 2>/dev/null; }; }

can_install() { ! no_system && has apt-get && can_be_root; }

as_root() {
    if [[ $EUID -eq 0 ]]; then DEBIAN_FRONTEND=noninteractive "$@"; else sudo -n env DEBIAN_FRONTEND=noninteractive "$@"; fi
}

# Prints system-wide installations to standard error, so that functions can print results.
announce() { say "installing system-wide, with apt-get as root: $* (NO_SYSTEM=1 make ... refrains)" >&2; }

# A broken third-party package source must not stop the setup, so a failed update is only reported.
update() { as_root apt-get update -qq >&2 || say "apt-get update reported errors; continuing with the old package lists" >&2; }

install() { as_root apt-get install -y -qq --no-install-recommends "$@" >&2; }
