#!/usr/bin/env bash
# Builds for Windows and runs all tests under Wine, those of devices on Mesa's software driver. Run by hand;
# arguments are passed on to `cargo test`. Needs, on Debian, gcc-mingw-w64-x86-64-posix, wine, wine64, xvfb,
# xauth and mesa-vulkan-drivers, and `rustup target add x86_64-pc-windows-gnu`.
set -euo pipefail
cd "$(dirname "$0")/.."
prefix=$(mktemp -d)
export WINEPREFIX=$prefix WINEDEBUG=-all
trap 'wineserver --kill || true; rm -rf "$prefix"' EXIT
# Wine's Vulkan needs a display.
export CARGO_TARGET_X86_64_PC_WINDOWS_GNU_RUNNER="xvfb-run --auto-servernum wine"
export CARGO_TARGET_X86_64_PC_WINDOWS_GNU_LINKER=x86_64-w64-mingw32-gcc

wineboot --init
# Rust takes random numbers from a function that Wine 8 lacks.
system=$prefix/drive_c/windows/system32
if ! [[ -e "$system/bcryptprimitives.dll" ]]; then
    x86_64-w64-mingw32-gcc -shared -o "$system/bcryptprimitives.dll" -x c - -x none -ladvapi32 <<'END'
#include <windows.h>
BOOLEAN NTAPI SystemFunction036(PVOID, ULONG);
__declspec(dllexport) BOOL WINAPI ProcessPrng(PBYTE bytes, SIZE_T count) { return SystemFunction036(bytes, count); }
END
fi

# The tests know the checkout by a path without a drive, which from a temporary folder is one of drive C.
mkdir -p "$prefix/drive_c$(dirname "$PWD")"
ln -s "$PWD" "$prefix/drive_c$PWD"

cargo test --release --target x86_64-pc-windows-gnu "$@"
