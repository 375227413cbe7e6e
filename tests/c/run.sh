#!/usr/bin/env bash
# Builds the C interface as a shared library, and programs against it, which it runs. Arguments go to cargo.
set -euo pipefail
cd "$(dirname "$0")/../.."
for tool in cc python3; do
    if ! command -v "$tool" >/dev/null; then echo "skipped: $tool is missing"; exit; fi
done
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

if command -v cbindgen >/dev/null; then
    # It says that constants of other modules, which it leaves out, have the same name.
    cbindgen --quiet --output "$scratch/fnopt.h" 2>/dev/null
    diff include/fnopt.h "$scratch/fnopt.h" || { echo "run cbindgen --output include/fnopt.h" >&2; exit 1; }
fi

# The shared library of this build: another one may have the same name there.
cargo rustc --release --lib --no-default-features --features capi --crate-type cdylib --message-format json "$@" >"$scratch/messages"
library=$(python3 - "$scratch/messages" <<'END'
import json, sys
lines = (json.loads(line) for line in open(sys.argv[1]) if line.startswith("{"))
files = [file for line in lines if line.get("target", {}).get("name") == "fnopt" for file in line.get("filenames", [])]
print(next(file for file in files if file.endswith((".so", ".dylib", ".dll"))))
END
)
cp "$library" "$scratch"
for program in examples/c/hang tests/c/errors; do
    name=$(basename "$program")
    cc -std=c99 -Wall -Wextra -Werror -pedantic -O1 -I include "$program.c" -o "$scratch/$name" -L "$scratch" -lfnopt -lm
    LD_LIBRARY_PATH="$scratch" DYLD_LIBRARY_PATH="$scratch" "$scratch/$name"
done

if command -v dotnet >/dev/null; then
    LD_LIBRARY_PATH="$scratch" dotnet run --project examples/csharp
elif command -v mcs >/dev/null && command -v mono >/dev/null; then
    mcs -langversion:latest -warnaserror -out:"$scratch/hang.exe" examples/csharp/Hang.cs
    LD_LIBRARY_PATH="$scratch" DYLD_LIBRARY_PATH="$scratch" mono "$scratch/hang.exe"
else
    echo "skipped: dotnet, or mcs and mono, are missing"
fi
