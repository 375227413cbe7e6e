#!/usr/bin/env bash
# Builds the page into a folder, out/browser unless another is given. Needs the target wasm32-unknown-unknown (rustup target
# add) and wasm-bindgen in the version of Cargo.lock (cargo install wasm-bindgen-cli --version ..).
set -euo pipefail
folder=$(realpath -m "${1:-$(dirname "$0")/../../out/browser}")
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-target}
cargo build --locked --release --no-default-features --features weights --example browser --target wasm32-unknown-unknown
mkdir -p "$folder"
wasm-bindgen --target web --no-typescript --out-dir "$folder" "$target/wasm32-unknown-unknown/release/examples/browser.wasm"
cp examples/browser/*.{html,css,js} "$folder"
