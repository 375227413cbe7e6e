#!/usr/bin/env bash
# The cloth in Bevy: builds examples/bevy, draws two of its frames without a window, and checks that the cloth is in the
# pictures and moves. Run by hand: the first build takes long, and CI has no time for it. Needs a Vulkan driver, a software one
# at least, and python3.
set -euo pipefail
cd "$(dirname "$0")/.."
export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$PWD/target}/bevy
if ! compgen -G "/usr/share/vulkan/icd.d/*.json" >/dev/null && ! compgen -G "/etc/vulkan/icd.d/*.json" >/dev/null; then
    echo "skipped: no Vulkan driver is installed"
    exit
fi
out=${1:-$(mktemp -d)}
mkdir -p "$out"
# Bevy 0.20 asks for Rust 1.97 and builds with 1.95.
cargo build --ignore-rust-version --manifest-path examples/bevy/Cargo.toml
for frames in 10 60; do
    "$CARGO_TARGET_DIR/debug/fnopt-bevy" --screenshot "$out/$frames.png" --frames "$frames"
done
python3 - "$out" <<'END'
import struct, sys, zlib


def pixels(path):
    """Returns the rows of a PNG of 8 bits a channel, as lists of (r, g, b)."""
    data = open(path, "rb").read()
    at, packed = 8, b""
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + 8 + length]
        if kind == b"IHDR":
            width, height, depth, colour = struct.unpack(">IIBB", body[:10])
            assert depth == 8 and colour in (2, 6), (depth, colour)
        elif kind == b"IDAT":
            packed += body
        at += 12 + length
    step = 3 if colour == 2 else 4
    raw, line = zlib.decompress(packed), bytearray(width * step)
    rows = []
    for y in range(height):
        start = y * (width * step + 1)
        kind, above, line = raw[start], line, bytearray(raw[start + 1 : start + 1 + width * step])
        for k in range(len(line)):
            left, up = line[k - step] if k >= step else 0, above[k]
            corner = above[k - step] if k >= step else 0
            guess = left + up - corner
            nearest = min((left, up, corner), key=lambda value: abs(guess - value))
            line[k] = (line[k] + (0, left, up, (left + up) // 2, nearest)[kind]) & 255
        rows.append([tuple(line[x : x + 3]) for x in range(0, len(line), step)])
    return rows


def cloth(rows):
    """Returns where the picture is blue, as nothing but the cloth is."""
    return {(x, y) for y, row in enumerate(rows) for x, (r, g, b) in enumerate(row) if b > 1.5 * r and b > 1.2 * g and b > 30}


first, last = (cloth(pixels(f"{sys.argv[1]}/{frames}.png")) for frames in (10, 60))
size = 640 * 480
print(f"the cloth covers {len(first) / size:.1%} of the first picture, {len(last) / size:.1%} of the last, {len(first & last) / size:.1%} of both")
assert all(0.02 * size < len(seen) < 0.6 * size for seen in (first, last)), "the cloth covers a part of the pictures"
assert len(first ^ last) > 0.01 * size, "the cloth moves"
END
echo "done: $out"
