#!/usr/bin/env bash
# Builds the bridge, the simulator and their tests with a sanitizer, and runs all tests: thread or address.
# The build is kept in the folder that the second argument names, by default below $TMPDIR.
set -euo pipefail
sanitizer="${1:?which sanitizer: thread or address}"
source="$(cd "$(dirname "$0")/.." && pwd)"
build="${2:-${TMPDIR:-/tmp}/station-kord-$sanitizer-$(id -u)}"
generator=()
command -v ninja >/dev/null && generator=(-G Ninja)
cmake "${generator[@]}" -S "$source" -B "$build" -DCMAKE_BUILD_TYPE=RelWithDebInfo \
    -DCMAKE_CXX_FLAGS_RELWITHDEBINFO="-O1 -g1" -DSTATION_KORD_BACKEND=sim -DSTATION_KORD_PYTHON=OFF \
    -DSTATION_KORD_TESTS=ON -DSTATION_KORD_SANITIZER="$sanitizer" \
    -DCMAKE_UNITY_BUILD=ON -DCMAKE_UNITY_BUILD_BATCH_SIZE=0 >/dev/null  # half the time: each header is read once
cmake --build "$build" --parallel 2 >"$build/log" 2>&1 || { cat "$build/log" >&2; exit 1; }
export TSAN_OPTIONS="halt_on_error=1 second_deadlock_stack=1" ASAN_OPTIONS="detect_leaks=1"
# The thread sanitizer of older compilers cannot live with as many random address bits as newer kernels use.
run=()
setarch "$(uname -m)" -R true 2>/dev/null && run=(setarch "$(uname -m)" -R)
"${run[@]}" "$build/tests/station_kord_tests"
