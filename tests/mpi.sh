#!/usr/bin/env bash
# Two ranks over real MPI: they finish, resume to the same bits, refuse other numbers of ranks, end together.
# Needs Open MPI with its headers and libclang (Debian: libopenmpi-dev openmpi-bin libclang-dev). Run by hand.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --features mpi
fnopt=${CARGO_TARGET_DIR:-target}/release/fnopt
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
# Another kind of build may replace the binary in the meantime.
cp "$fnopt" "$scratch/fnopt"

fail() { echo "mpi: $1" >&2; exit 1; }
# ranks COUNT ARGUMENTS..: trains on COUNT ranks.
ranks() { mpirun -n "$1" --allow-run-as-root --oversubscribe --bind-to none "$scratch/fnopt" train --device cpu "${@:2}"; }
# data FILE: prints the tensors of a safetensors file, without its header, which holds times.
data() { tail -c +$(($(od -An -t u8 -N 8 "$1") + 9)) "$1"; }
same() { cmp <(data "$scratch/once/$1") <(data "$scratch/twice/$1") || fail "$1 has other bits after resuming"; }

cat >"$scratch/tiny.toml" <<'END'
steps = 1000000
log_every = 2
checkpoint = { every = { steps = 1000000 } }
[network]
lifting = 8
channels = 8
projection = 8
layers = 2
[[pool]]
grid = [8, 8]
iterations = 3
cloths = 6
batch = 2
[validation]
every = { steps = 1000000 }
frames = 2
grids = [[8, 8]]
END

echo "== six steps"
ranks 2 "$scratch/tiny.toml" --out "$scratch/once" --steps 6 | tee "$scratch/said"
[[ "$(grep -c "6 of" "$scratch/said")" == 1 ]] || fail "expected exactly one rank to report completion"
[[ "$(wc -l <"$scratch/once/metrics.csv")" == 4 ]] || fail "not one rank writes metrics.csv"

echo "== three steps, and three after resuming"
ranks 2 "$scratch/tiny.toml" --out "$scratch/twice" --steps 3
ranks 2 --resume "$scratch/twice" --steps 6
same weights/last.safetensors
same checkpoints/step-00000006.safetensors
same checkpoints/step-00000006.rank1.safetensors

echo "== other numbers of ranks"
for count in 1 3; do
    if ranks "$count" --resume "$scratch/once" --steps 8 2>"$scratch/said"; then fail "$count ranks resume a run of 2"; fi
    grep -q "ranks: expected 2, as many as the run began with, found $count" "$scratch/said" || fail "no clear error"
done

echo "== an error on one rank"
mkdir "$scratch/once/checkpoints/step-00000008.rank1.safetensors"
code=0
ranks 2 --resume "$scratch/once" --steps 8 2>"$scratch/said" || code=$?
[[ "$code" == 2 ]] || fail "exit code $code, not 2"
grep -q "error on rank 1: .*cannot write" "$scratch/said" || fail "the error was not reported"

echo "== interrupted, with the signal that launchers send"
ranks 2 "$scratch/tiny.toml" --out "$scratch/stopped" 2>"$scratch/said" &
job=$!
while ! [[ -s "$scratch/stopped/metrics.csv" && "$(wc -l <"$scratch/stopped/metrics.csv")" -gt 4 ]]; do
    kill -0 "$job" || fail "the run ended"
    sleep 0.2
done
for process in $(pgrep -f "^$scratch/fnopt "); do
    if grep -qz '^OMPI_COMM_WORLD_RANK=0$' "/proc/$process/environ"; then kill -TERM "$process"; fi
done
code=0
wait "$job" || code=$?
[[ "$code" == 130 ]] || fail "exit code $code, not 130"
grep -q "interrupted: .* continue with --resume" "$scratch/said" || fail "the interruption was not reported"
[[ "$(ls "$scratch/stopped/checkpoints" | wc -l)" == 2 ]] || fail "not a checkpoint of both ranks"
step=$(ls "$scratch/stopped/checkpoints" | sed -n 's/^step-0*\([0-9]*\)\.safetensors$/\1/p')
ranks 2 --resume "$scratch/stopped" --steps "$((step + 2))"
echo "== done"
