#!/usr/bin/env bash
# The library in a browser: builds the page of examples/browser, and drives it in headless Chromium on SwiftShader; the energies
# of its first frames are compared with those of the CPU path. Arguments are names of checks in tests/browser/page.py, all if
# there are none. What it needs: the target wasm32-unknown-unknown (rustup target add), wasm-bindgen in the version of Cargo.lock
# (cargo install wasm-bindgen-cli --version ..), and Chromium with ChromeDriver (Debian's packages chromium and chromium-driver).
# If something is missing it says so and ends; with --install, it first installs what it can.
set -euo pipefail
cd "$(dirname "$0")/.."
skip() { echo "skipped: $1"; exit 0; }
target=${CARGO_TARGET_DIR:-target}
export PATH=$PATH:$target/tools/bin
version=$(grep -A1 '^name = "wasm-bindgen"$' Cargo.lock | sed -n 's/version = "\(.*\)"/\1/p')
has_bindgen() { [[ $(wasm-bindgen --version 2>/dev/null) == "wasm-bindgen $version" ]]; }
if [[ ${1:-} == --install ]]; then
    shift
    if ! has_bindgen; then
        CARGO_PROFILE_RELEASE_OPT_LEVEL=1 cargo install --quiet wasm-bindgen-cli --version "$version" --root "$target/tools" || true
    fi
    if ! command -v chromedriver >/dev/null && ((EUID == 0)) && command -v apt-get >/dev/null; then
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium chromium-driver >/dev/null || true
    fi
fi
has_bindgen || skip "wasm-bindgen $version is missing"
for program in chromium chromedriver python3; do command -v "$program" >/dev/null || skip "$program is missing"; done
rustup target list --installed | grep -qx wasm32-unknown-unknown || skip "the target wasm32-unknown-unknown is missing"
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
examples/browser/build.sh "$scratch/page"
cargo run --release --quiet -- rollout --device cpu --iterations 10 --frames 4 --no-pictures --out "$scratch/native" >/dev/null
python3 tests/browser/page.py "$scratch/page" "$scratch/native/report.json" "$@"
