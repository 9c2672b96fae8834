# Shared by the scripts of `make setup`. Sourced, not run.
#
# What is installed outside .venv is named before it is installed, and with NO_SYSTEM=1 not installed at all.

say() { printf '== %s\n' "$*"; }
has() { command -v "$1" >/dev/null 2>&1; }

# Whether packages of the system are to be left alone.
no_system() { [[ -n "${NO_SYSTEM:-}" && "${NO_SYSTEM}" != 0 ]]; }

can_be_root() { [[ $EUID -eq 0 ]] || { has sudo && sudo -n true 2>/dev/null; }; }

can_install() { ! no_system && has apt-get && can_be_root; }

as_root() {
    if [[ $EUID -eq 0 ]]; then DEBIAN_FRONTEND=noninteractive "$@"; else sudo -n env DEBIAN_FRONTEND=noninteractive "$@"; fi
}

# Says what is about to be installed system-wide, on standard error, so that a function may print a result.
announce() { say "installing system-wide, with apt-get as root: $* (NO_SYSTEM=1 make ... refrains)" >&2; }

# Somebody else's broken source must not stop ours: a failed update is told, not fatal.
update() { as_root apt-get update -qq >&2 || say "apt-get update reported errors; going on with what it has" >&2; }

install() { as_root apt-get install -y -qq --no-install-recommends "$@" >&2; }
