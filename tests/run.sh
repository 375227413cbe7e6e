#!/usr/bin/env bash
# Runs all tests. They need a Vulkan driver, and any will do: where none is found, Debian's software driver is installed.
set -euo pipefail
cd "$(dirname "$0")/.."

has_driver() {
    [ -n "${VK_DRIVER_FILES:-}${VK_ICD_FILENAMES:-}" ] && return 0
    compgen -G '/usr/share/vulkan/icd.d/*.json' >/dev/null && return 0
    compgen -G '/etc/vulkan/icd.d/*.json' >/dev/null
}

if [ "$(uname -s)" = Linux ] && ! has_driver; then
    if command -v apt-get >/dev/null; then
        root=$([ "$(id -u)" = 0 ] || echo sudo)
        $root apt-get update -qq
        $root apt-get install -y -qq mesa-vulkan-drivers libvulkan1
    else
        echo "tests/run.sh: no Vulkan driver found; install one (Mesa's lavapipe is enough)" >&2
        exit 2
    fi
fi

exec cargo test --release "$@"
