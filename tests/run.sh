#!/usr/bin/env bash
# Runs all tests. They need a software Vulkan driver, even next to a GPU's; Mesa's is installed if need be.
# With arguments, `cargo test` with them, as in `tests/run.sh --test cli`.
set -euo pipefail
cd "$(dirname "$0")/.."

has_driver() {
    case "${VK_DRIVER_FILES:-}${VK_ICD_FILENAMES:-}" in
        *lvp* | *swiftshader*) return ;;
    esac
    # Containers may restrict programs to a GPU's driver this way.
    unset VK_DRIVER_FILES VK_ICD_FILENAMES
    local folder
    for folder in /usr/share /etc /usr/local/share /run/opengl-driver/share "${HOME:-}/.local/share"; do
        if compgen -G "$folder/vulkan/icd.d/lvp_icd*.json" >/dev/null; then return; fi
    done
    return 1
}

if [[ "$(uname -s)" == Linux ]] && ! has_driver; then
    as_root=()
    ((EUID == 0)) || as_root=(sudo)
    if command -v apt-get >/dev/null && { ((EUID == 0)) || command -v sudo >/dev/null; }; then
        echo "no software Vulkan driver found: installing Mesa's software driver"
        "${as_root[@]}" apt-get update -qq
        "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
            mesa-vulkan-drivers libvulkan1
    else
        echo "no software Vulkan driver found: install the Vulkan loader and Mesa's software driver" \
            "(Debian and Ubuntu: mesa-vulkan-drivers libvulkan1; Fedora: mesa-vulkan-drivers vulkan-loader;" \
            "Arch: vulkan-swrast vulkan-icd-loader)" >&2
        exit 2
    fi
fi

if (($#)); then exec cargo test --release "$@"; fi

cargo test --release --no-run
# Tests of devices take turns on one, which leaves cores idle: all others run beside them, and are printed first.
of_devices=$(mktemp)
cargo test --release --test gpu >"$of_devices" 2>&1 &
devices=$!
ended() {
    pkill -P "$devices" || true
    cat "$of_devices"
    rm -f "$of_devices"
}
trap ended EXIT
others=()
for file in tests/*.rs tests/*/main.rs; do
    name=${file#tests/}
    name=${name%.rs}
    case ${name%/main} in
        # The viewer's need a feature that is off by default.
        gpu | view) ;;
        *) others+=(--test "${name%/main}") ;;
    esac
done
failed=0
cargo test --release --lib --bins "${others[@]}" && cargo test --release --doc || failed=$?
wait "$devices" || failed=$?
exit "$failed"
