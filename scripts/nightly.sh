#!/usr/bin/env bash
# What takes too long for every change: the tests marked nightly, every expert on fresh scenes, hidden states, nonsense sent
# to every environment. Goes through all of it and ends with status 1 if any part failed. WORKERS=2 SEEDS=1 bash scripts/nightly.sh
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

out=${OUT:-outputs/nightly} workers=${WORKERS:-$(nproc)} seeds=${SEEDS:-1}
python=.venv/bin/python
# Scenes of the day: an expert that only knows the scenes it was tuned on is found out sooner or later.
first_seed=${FIRST_SEED:-$((8000000 + 10#$(date -u +%j) * 2000))}
export OMP_NUM_THREADS=1 PYTHONUNBUFFERED=1
failed=()
mkdir -p "$out"

# Runs "$2"... as part "$1", and goes on whatever comes of it.
part() {
    local name=$1 began=$SECONDS
    shift
    printf '\n== %s: %s\n' "$name" "$*"
    "$@" || failed+=("$name")
    printf '== %s: %d s\n' "$name" $((SECONDS - began))
}

part "long tests" "$python" -m pytest -m nightly
part "experts" "$python" scripts/check_experts.py --category all --preset paper,hard --splits seen,unseen,novel --episodes "$((10 * seeds))" --first-seed "$first_seed" --workers "$workers"
part "robustness" "$python" scripts/check_robustness.py --category all --seeds 20 --workers "$workers"

if ((${#failed[@]})); then
    printf '\n== failed: %s (scenes from seed %s)\n' "${failed[*]}" "$first_seed"
    exit 1
fi
printf '\n== all of it passed (scenes from seed %s)\n' "$first_seed"
