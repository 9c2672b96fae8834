#!/usr/bin/env bash
# Sets up a Vulkan device for SAPIEN: a GPU, else Mesa's lavapipe (on the CPU; Mesa >= 24.3). With the argument
# "libraries", installs only the libraries to import SAPIEN and OpenCV: clouds need no Vulkan device.
# Installs packages on Debian and Ubuntu as root, after naming them; with NO_SYSTEM=1, and elsewhere, it prints them.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

MIN_MESA=24.3
# sapien needs libx11; opencv-python needs libGL, glib, libSM and libXext; the NVIDIA driver needs libEGL.
LIBRARIES=(libvulkan1 libgl1 libegl1 libglib2.0-0 libx11-6 libxext6 libsm6)
BACKPORTS_FILE=/etc/apt/sources.list.d/adamanip-backports.sources

source scripts/setup_common.sh

# In a separate process: a broken driver may segfault instead of raising.
renders() { timeout 180 .venv/bin/python -m lerobot_env_adamanip.sim.render_probe; }

imports() { .venv/bin/python -c "import sapien, cv2" 2>/dev/null; }

# Installed packages keep their versions, since other programs may need them.
install_libraries() { install --no-upgrade "${LIBRARIES[@]}"; }

# The newest version apt would install, `$1` a package and `$2` (optional) a release to prefer.
candidate() { LC_ALL=C apt-cache ${2:+-t "$2"} policy "$1" 2>/dev/null | awk '/Candidate:/ {print $2}'; }

new_enough() { [[ -n "${1:-}" && "$1" != "(none)" ]] && dpkg --compare-versions "$1" ge "$MIN_MESA~"; }

release() { (. /etc/os-release && printf '%s' "${!1:-}"); }

# The mirror this machine already uses for its own release, so that a local mirror or proxy is respected.
debian_mirror() {
    local uri
    uri=$(LC_ALL=C apt-cache policy 2>/dev/null |
        awk -v suite="$(release VERSION_CODENAME)/main" '$1 ~ /^[0-9]+$/ && $3 == suite && $2 !~ /security/ {print $2; exit}')
    printf '%s' "${uri:-<your Debian mirror>}"
}

backports_source() {
    cat <<TEXT
Types: deb
URIs: $(debian_mirror)
Suites: bookworm-backports
Components: main
Signed-By: /usr/share/keyrings/debian-archive-keyring.gpg
TEXT
}

has_backports() { LC_ALL=C apt-cache policy 2>/dev/null | grep -q 'bookworm-backports/main'; }

advise() {
    echo "error: no Vulkan device that SAPIEN can render with." >&2
    echo "  try, as root:" >&2
    case "$(release ID) $(release VERSION_ID)" in
        "debian 12")
            { echo "    cat > $BACKPORTS_FILE <<'EOF'"; backports_source; echo "EOF"; } >&2
            echo "    apt-get update && apt-get install -y ${LIBRARIES[*]} && apt-get install -y -t bookworm-backports mesa-vulkan-drivers" >&2 ;;
        "ubuntu 22.04" | "ubuntu 23."*)
            echo "    # this release's own Mesa is older than $MIN_MESA" >&2
            echo "    apt-get update && apt-get install -y software-properties-common && add-apt-repository -y ppa:kisak/kisak-mesa" >&2
            echo "    apt-get update && apt-get install -y ${LIBRARIES[*]} mesa-vulkan-drivers" >&2 ;;
        *)
            echo "    # Mesa must be >= $MIN_MESA" >&2
            echo "    apt-get update && apt-get install -y ${LIBRARIES[*]} mesa-vulkan-drivers" >&2 ;;
    esac
    echo "  with an NVIDIA GPU: the driver's Vulkan part (libnvidia-gl-<version>; in a container NVIDIA_DRIVER_CAPABILITIES=all)" >&2
    echo "  then run make again; '.venv/bin/adamanip doctor' shows what is missing" >&2
    exit 1
}

install_mesa() {
    announce "mesa-vulkan-drivers ${LIBRARIES[*]}, and their dependencies"
    update
    if [[ "$(release ID) $(release VERSION_ID)" == "debian 12" ]]; then
        if ! has_backports; then
            announce "the package source bookworm-backports, in $BACKPORTS_FILE"
            backports_source | as_root tee "$BACKPORTS_FILE" >/dev/null
            update
        fi
        new_enough "$(candidate mesa-vulkan-drivers bookworm-backports)" || advise
        install -t bookworm-backports mesa-vulkan-drivers
    else
        new_enough "$(candidate mesa-vulkan-drivers)" || advise
        install mesa-vulkan-drivers
    fi
}

done_if_found() {
    if [[ -n "$found" ]]; then
        say "SAPIEN renders: $found"
        exit 0
    fi
}

if [[ "${1:-}" == libraries ]]; then
    if ! imports; then
        can_install || advise
        announce "${LIBRARIES[*]}"
        update
        install_libraries
        imports || advise
    fi
    say "the simulator can be imported; for pictures: make pictures"
    exit 0
fi

found=$(renders 2>/dev/null) || found=""
if has nvidia-smi && nvidia-smi >/dev/null 2>&1 && [[ "$found" != *cuda* ]]; then
    if can_install; then
        say "NVIDIA GPU found that SAPIEN does not render with; its Vulkan driver needs libraries"
        announce "${LIBRARIES[*]}"
        update
        install_libraries || true
        found=$(renders 2>/dev/null) || found=""
    fi
    [[ "$found" == *cuda* ]] || say "the GPU's driver lacks its Vulkan part (libnvidia-gl-<version>; in a container NVIDIA_DRIVER_CAPABILITIES=all)"
fi
done_if_found

can_install || advise
say "no Vulkan device to render with: Mesa's (on the CPU) will do"
install_mesa
install_libraries
found=$(renders) || advise
done_if_found
